"""mkdocs hook: writes the reference pages from what the program itself knows, at build time.

Nothing of it is stored, so nothing can be out of date: the command line from the parser, the file formats
from their models, the bus from the DBC, the summary from its JSON schema.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cli_page import cli_page
from dbc_page import dbc_page
from files_page import line_page, scenario_page, train_page
from python_page import python_page
from summary_page import summary_page

PAGES: dict[str, Callable[[], str]] = {
    "reference/cli.md": cli_page,
    "reference/scenario.md": scenario_page,
    "reference/line.md": line_page,
    "reference/train.md": train_page,
    "reference/dbc.md": dbc_page,
    "reference/summary.md": summary_page,
    "reference/python.md": python_page,
}


SHIM = "https://unpkg.com/iframe-worker/shim"
"""What the theme's offline plugin loads so that search works in a page opened from a folder."""


def on_files(files: Any, config: Any) -> Any:
    """Add the generated pages to those of docs/."""
    from mkdocs.structure.files import File

    for uri, page in PAGES.items():
        files.append(File.generated(config, uri, content=page()))
    return files


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Take the shim from the site itself: the site must work without a network."""
    return output.replace(SHIM, _up(page.url) + "assets/iframe-worker.js")


def on_post_template(output_content: str, template_name: str, config: Any) -> str:
    """The same for the pages that are no documents, 404.html."""
    return output_content.replace(SHIM, "assets/iframe-worker.js")


def _up(url: str) -> str:
    """From a page to the root of the site."""
    return "../" * url.count("/")
