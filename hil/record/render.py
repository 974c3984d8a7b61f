"""Pictures of a recording without a display: the viewer draws a tab of its dashboard into a PNG.

Needs a Vulkan driver; on a machine without a graphics card Mesa's software driver does
(Debian package mesa-vulkan-drivers).
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

from PIL import Image
from rerun.experimental import ViewerClient

from hil.record.errors import RecordError, RecordingUnreadable, ViewerUnavailable
from hil.record.viewer import free_port, viewer_binary

__all__ = [
    "MISSING_DRIVER",
    "headless_viewer",
    "render",
    "render_all",
    "render_views",
    "vulkan_driver_missing",
]

MISSING_DRIVER = (
    "the viewer cannot draw here: no Vulkan driver; install the Debian package mesa-vulkan-drivers"
    " (make system-deps)"
)
DRIVER_FOLDERS = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d")
BARS_ABOVE, BARS_BELOW = 66.0, 30.0
"""Pixels of the viewer's menu and tabs, and of its time line."""

Rectangle = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels."""

STILL_FRAMES = 3
"""So many equal pictures in a row mean that the viewer has drawn all it has; data arrive on demand."""


def render(rrd: Path, png: Path, *, tab: str | None = None, timeout_s: float = 60.0) -> None:
    """Draw one tab of a recording's dashboard (default: the first) to a PNG file, 1920 x 1080.

    Raises RecordError for an unknown tab, RecordingUnreadable, and ViewerUnavailable when the viewer or
    a Vulkan driver is missing.
    """
    for name, picture in _pictures(rrd, tab, timeout_s):
        if tab is None or name == tab:
            png.parent.mkdir(parents=True, exist_ok=True)
            png.write_bytes(picture)
            return


def render_all(rrd: Path, folder: Path, *, timeout_s: float = 60.0) -> dict[str, Path]:
    """Draw every tab to `folder/<tab>.png`, in lower case; tab -> file."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {}
    for name, picture in _pictures(rrd, None, timeout_s):
        files[name] = folder / f"{_file_name(name)}.png"
        files[name].write_bytes(picture)
    return files


def render_views(rrd: Path, folder: Path, *, timeout_s: float = 60.0) -> dict[str, dict[str, Path]]:
    """Draw every tab, and cut every view out of it; tab -> name of the view -> file.

    The whole tab is there under the empty name. Raises as `render` does.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, dict[str, Path]] = {}
    with headless_viewer() as viewer:
        for name, picture in _tabs_drawn(viewer, rrd, None, timeout_s):
            document = viewer.get_blueprint(of="recording").blueprint
            content = _tabs(document)[1][name]
            whole = Image.open(io.BytesIO(picture)).convert("RGB")
            width, height = whole.size
            area = (0.0, BARS_ABOVE, float(width), height - BARS_BELOW)
            cuts = {"": (0.0, 0.0, float(width), float(height))} | _rectangles(document, content, area)
            files[name] = {}
            for view, corners in cuts.items():
                stem = "-".join(filter(None, (_file_name(name), _file_name(view))))
                again = sum(1 for each in files[name].values() if re.fullmatch(rf"{stem}(_\d+)?", each.stem))
                files[name][view] = folder / (f"{stem}_{again + 1}.png" if again else f"{stem}.png")
                left, top, right, bottom = (round(corner) for corner in corners)
                whole.crop((left, top, right, bottom)).save(files[name][view])
    return files


def vulkan_driver_missing() -> bool:
    """Whether there is no Vulkan driver on this Linux machine; elsewhere the system brings one."""
    if not sys.platform.startswith("linux"):
        return False
    named = os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES")
    return not named and not any(list(Path(folder).glob("*.json")) for folder in DRIVER_FOLDERS)


def _pictures(rrd: Path, wanted: str | None, timeout_s: float) -> Iterator[tuple[str, bytes]]:
    with headless_viewer() as viewer:
        yield from _tabs_drawn(viewer, rrd, wanted, timeout_s)


def _tabs_drawn(
    viewer: ViewerClient, rrd: Path, wanted: str | None, timeout_s: float
) -> Iterator[tuple[str, bytes]]:
    """Show one tab after the other; each is still on the screen while its picture is yielded."""
    if not rrd.is_file():
        raise RecordingUnreadable(f"{rrd}: no such recording")
    viewer.open(str(rrd.resolve()))
    document = viewer.get_blueprint(of="recording").blueprint
    path, tabs = _tabs(document)
    if not tabs:
        raise RecordingUnreadable(f"{rrd}: this recording has no dashboard")
    if wanted is not None and wanted not in tabs:
        raise RecordError(f"{rrd}: no tab {wanted!r}; it has {', '.join(tabs)}")
    for name, content in tabs.items():
        if wanted is None or name == wanted:
            document[path]["ContainerBlueprint"]["active_tab"] = content
            viewer.set_blueprint(document, of="recording")
            yield name, _still_picture(viewer, timeout_s)


def _tabs(document: Mapping[str, Any]) -> tuple[str, dict[str, str]]:
    """Path of the container of the tabs in a blueprint, and name -> content of each tab."""
    for path, node in document.items():
        container = node.get("ContainerBlueprint", {})
        if container.get("container_kind") == "Tabs":
            contents = [str(content) for content in _list(container.get("contents"))]
            return path, {_name(document, content): content for content in contents}
    return "", {}


def _rectangles(document: Mapping[str, Any], content: str, area: Rectangle) -> dict[str, Rectangle]:
    """Where the views of a container lie, by name: from its kind and shares, as the viewer lays it out."""
    path = content if content.startswith("/") else f"/{content}"
    container = document.get(path, {}).get("ContainerBlueprint")
    if container is None:
        return {_name(document, content): area}
    contents = [str(each) for each in _list(container.get("contents"))]
    kind = str(container.get("container_kind"))
    columns = {"Horizontal": len(contents), "Vertical": 1}.get(kind) or int(
        container.get("grid_columns") or 2
    )
    rows = -(-len(contents) // columns)
    across = _spans(area[0], area[2], container.get("col_shares"), columns)
    down = _spans(area[1], area[3], container.get("row_shares"), rows)
    found: dict[str, Rectangle] = {}
    for place, each in enumerate(contents):
        (left, right), (top, bottom) = across[place % columns], down[place // columns]
        found |= _rectangles(document, each, (left, top, right, bottom))
    return found


def _spans(low: float, high: float, shares: object, count: int) -> list[tuple[float, float]]:
    known = [float(share) for share in _list(shares)][:count]
    known += [1.0] * (count - len(known))
    edges = [low]
    for share in known:
        edges.append(edges[-1] + share / sum(known) * (high - low))
    return list(pairwise(edges))


def _list(values: Any) -> list[Any]:
    """A list of a blueprint, which tells a single element without a list around it."""
    if values is None:
        return []
    return list(values) if isinstance(values, list | tuple) else [values]


def _file_name(title: str) -> str:
    """A title as part of a file's name: its letters and digits before the first bracket or sign."""
    words = re.split(r"[\[:;,·±%]", title.lower(), maxsplit=1)[0]
    return re.sub(r"[^a-z0-9]+", "_", words).strip("_")


def _name(document: Mapping[str, Any], content: str) -> str:
    node = document.get(content if content.startswith("/") else f"/{content}", {})
    for part in ("ContainerBlueprint", "ViewBlueprint"):
        if "display_name" in node.get(part, {}):
            return str(node[part]["display_name"])
    return content


def _still_picture(viewer: ViewerClient, timeout_s: float) -> bytes:
    deadline = time.monotonic() + timeout_s
    last, equal = b"", 0
    while equal < STILL_FRAMES:
        if time.monotonic() > deadline:
            raise ViewerUnavailable(f"the viewer did not finish drawing within {timeout_s:g} s")
        time.sleep(0.2)
        picture = bytes(viewer.take_screenshot())
        equal = equal + 1 if picture == last else 0
        last = picture
    return last


@contextlib.contextmanager
def headless_viewer() -> Iterator[ViewerClient]:
    """A viewer without a window, on a port of its own, gone afterwards. Raises ViewerUnavailable."""
    if vulkan_driver_missing():
        raise ViewerUnavailable(MISSING_DRIVER)
    with tempfile.TemporaryDirectory() as scratch, _environment(XDG_RUNTIME_DIR=scratch, RUST_LOG="error"):
        try:
            client = ViewerClient.spawn(
                headless=True,
                port=free_port(),
                executable_path=str(viewer_binary()),
                hide_welcome_screen=True,
            )
        except RuntimeError as error:
            raise ViewerUnavailable(f"the viewer did not start: {' '.join(str(error).split())}") from None
        with client:
            yield client


@contextlib.contextmanager
def _environment(**variables: str) -> Iterator[None]:
    """Environment variables for a child, without changing those that are set."""
    added = {name: value for name, value in variables.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)
