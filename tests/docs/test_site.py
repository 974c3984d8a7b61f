"""The site: strict build, every page in it, and nothing in it that is fetched from elsewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LOADED = re.compile(
    r"<(?:script|img|iframe|source)\b[^>]*\bsrc=\"?(https?:)?//|<link\b[^>]*\brel=\"?(?:stylesheet|preconnect|icon|preload)[^>]*href=\"?https?://"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(out)],
        cwd=ROOT, capture_output=True, text=True, timeout=120,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return out


def test_every_page_is_built_and_in_the_navigation(site):
    home = (site / "index.html").read_text()
    for source in (ROOT / "docs").rglob("*.md"):
        page = source.relative_to(ROOT / "docs").with_suffix(".html").as_posix()
        assert (site / page).exists()
        assert page == "index.html" or f'href="{page}"' in home or f"href={page}" in home, page


def test_nothing_is_loaded_from_elsewhere(site):
    for page in site.rglob("*.html"):
        found = LOADED.search(page.read_text())
        assert found is None, f"{page.name}: {found and found[0]}"
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?https?:", sheet.read_text()), sheet.name


def test_search_works_without_a_server(site):
    assert list((site / "search").glob("search_index.js")), "the offline plugin has not written its index"


def test_no_page_needs_a_diagram_library(site):
    assert not [page.name for page in site.rglob("*.html") if 'class="mermaid"' in page.read_text()]
