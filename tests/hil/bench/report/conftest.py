"""A real browser for reports: headless Chromium, spoken to over its debugging pipe; and a recorded run."""

import base64
import contextlib
import json
import os
import shutil
import subprocess
import sys

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
NEEDS = "needs a Chromium: apt-get install --no-install-recommends chromium"
TROUBLE = ("Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded")


class Browser:
    """One page of a headless Chromium by the Chrome DevTools Protocol; messages end with a zero byte."""

    def __init__(self, profile):
        to_browser, ours_out = os.pipe()
        ours_in, from_browser = os.pipe()
        self._out, self._in = os.fdopen(ours_out, "wb", 0), os.fdopen(ours_in, "rb", 0)
        keep = [os.dup(to_browser), os.dup(from_browser)]  # clear of 3 and 4, onto which they are moved
        script = f'exec "$@" 3<&{keep[0]} 4>&{keep[1]}'
        command = [CHROMIUM, "--headless=new", "--remote-debugging-pipe", "--no-sandbox", "--disable-gpu"]
        command += ["--no-first-run", "--disable-dev-shm-usage", f"--user-data-dir={profile}", "about:blank"]
        self._process = subprocess.Popen(
            ["/bin/bash", "-c", script, "bash", *command], pass_fds=keep, stderr=subprocess.DEVNULL
        )
        for descriptor in (to_browser, from_browser, *keep):
            os.close(descriptor)
        self._number, self._rest, self.events, self._session = 0, b"", [], None
        page = next(t for t in self.ask("Target.getTargets")["targetInfos"] if t["type"] == "page")
        attached = self.ask("Target.attachToTarget", targetId=page["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def ask(self, method, **parameters):
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        self._out.write(json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def _read(self):
        while b"\0" not in self._rest:
            part = self._in.read(1 << 16)
            if not part:
                raise RuntimeError("Chromium has ended")
            self._rest += part
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)

    def open(self, path, *, width=1200, height=900, dark=False, mobile=False):
        """Load a file and wait for it; forgets what was heard before."""
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=mobile,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.ask("Emulation.setEmulatedMedia", media="", features=[scheme])
        self.events.clear()
        self.ask("Page.navigate", url=path.resolve().as_uri())
        while not any(event.get("method") == "Page.loadEventFired" for event in self.events):
            self.events.append(self._read())
        self.evaluate(
            "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))"
        )

    def evaluate(self, expression):
        found = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def trouble(self):
        """Console messages, uncaught errors and complaints of the browser since the page was opened."""
        return [event["params"] for event in self.events if event.get("method") in TROUBLE]

    def requests(self):
        """Addresses that the page asked for."""
        sent = [
            event["params"] for event in self.events if event.get("method") == "Network.requestWillBeSent"
        ]
        return [event["request"]["url"] for event in sent]

    def screenshot(self, *, whole=False):
        return base64.b64decode(self.ask("Page.captureScreenshot", captureBeyondViewport=whole)["data"])

    def pdf(self):
        return base64.b64decode(self.ask("Page.printToPDF", preferCSSPageSize=True)["data"])

    def close(self):
        with contextlib.suppress(RuntimeError, OSError):
            self._session = None
            self.ask("Browser.close")
        self._out.close()
        self._in.close()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    if CHROMIUM is None:
        pytest.skip(NEEDS)
    browser = Browser(tmp_path_factory.mktemp("chromium"))
    yield browser
    browser.close()


HOSTILE = "<script>alert(1)</script> & “co”"
"""A title that would run in the reader's browser if it were not escaped."""


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """A short run in lockstep, as `hil run` leaves it."""
    folder = tmp_path_factory.mktemp("recorded") / "a"
    words = [
        "run",
        "--lockstep",
        "-i",
        "virtual",
        "--out",
        str(folder),
        "--set",
        f"title={json.dumps(HOSTILE)}",
    ]
    done = subprocess.run([sys.executable, "-m", "hil", *words], capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def run(recorded, tmp_path):
    """A copy of the run that a test may spoil."""
    return shutil.copytree(recorded, tmp_path / "run")


def changed(folder, change):
    """Change the summary of a run in place."""
    path = folder / "summary.json"
    summary = json.loads(path.read_text())
    change(summary)
    path.write_text(json.dumps(summary))
    return folder


@pytest.fixture
def spoil():
    return changed
