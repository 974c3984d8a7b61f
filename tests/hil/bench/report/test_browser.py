"""The report in a real browser: a quiet console, nothing loaded, no sideways scrolling, themes, paper."""

import pytest

from hil.bench.report import write_comparison, write_report

PHONE, DESK = {"width": 390, "height": 844, "mobile": True}, {"width": 1200, "height": 900}
OVERFLOW = "document.documentElement.scrollWidth - window.innerWidth"
WIDER = """[...document.querySelectorAll("main *")].filter(e => !e.closest(".scroll, svg, pre, .word")
    && e.getBoundingClientRect().right > window.innerWidth + 0.5).map(e => e.outerHTML.slice(0, 120))"""
PAGE = "getComputedStyle(document.body).backgroundColor"
STROKES = "[...document.querySelectorAll('path.curve')].map(path => getComputedStyle(path).stroke)"
YELLOW = "rgb(242, 201, 76)"  # the reference on the dashboard; on white it could not be seen


@pytest.fixture(scope="module")
def pages(recorded, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    return (
        write_report(recorded, folder / "report.html").path,
        write_comparison([recorded, recorded], folder / "comparison.html").path,
    )


def test_the_browser_tells_of_trouble(browser, tmp_path):
    page = tmp_path / "bad.html"
    page.write_text(
        "<!DOCTYPE html><div style='width:3000px'>x</div><script>console.error('seen'); nothing()</script>"
    )
    browser.open(page, **PHONE)
    assert len(browser.trouble()) == 2
    assert browser.evaluate("document.documentElement.scrollWidth") > 390


@pytest.mark.parametrize("device", [PHONE, DESK], ids=["phone", "desk"])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_pages_fit_load_nothing_and_are_quiet(browser, pages, device, dark):
    for path in pages:
        browser.open(path, dark=dark, **device)
        assert browser.trouble() == []
        assert [url for url in browser.requests() if not url.startswith("data:")] == [path.resolve().as_uri()]
        assert browser.evaluate(OVERFLOW) <= 0
        assert browser.evaluate(WIDER) == []


def test_page_and_curves_follow_the_theme(browser, pages):
    seen = {}
    for dark in (False, True):
        browser.open(pages[0], dark=dark)
        seen[dark] = browser.evaluate(PAGE), browser.evaluate(STROKES)
    assert seen[False][0] == "rgb(255, 255, 255)"
    assert seen[True][0] == "rgb(20, 23, 27)"
    assert YELLOW in seen[True][1]
    assert YELLOW not in seen[False][1]


def test_every_picture_has_drawn_its_curves(browser, pages):
    for path in pages:
        browser.open(path, **DESK)
        boxes = browser.evaluate(
            "[...document.querySelectorAll('.plot > svg')].map(svg => Math.max(0, ..."
            "[...svg.querySelectorAll('path.curve, path.bars, path.area')]"
            ".map(path => path.getBoundingClientRect().width)))"
        )
        assert len(boxes) >= 6
        assert min(boxes) > 100


def test_it_prints(browser, pages):
    browser.open(pages[0], dark=True)
    pdf = browser.pdf()
    assert pdf.startswith(b"%PDF")
    assert 3 <= pdf.count(b"/Type /Page\n") + pdf.count(b"/Type/Page/") <= 20
