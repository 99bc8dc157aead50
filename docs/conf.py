"""The documentation as a site: `sphinx-build -W docs docs/_build`, then open docs/_build/index.html.

The pages are Markdown that code hosts show as well. Two things are added to Sphinx here:

* A link from a page to a file of the repository, `[`Name`](../../agents/config.py#L46)`, leads to a listing of that
  file in the site, at that line. A file or a line that does not exist is a warning, which `-W` makes an error.
* Each lesson offers itself as a notebook (docs/notebooks.py).
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from html import escape
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

from docutils import nodes
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import TextLexer, get_lexer_for_filename
from pygments.util import ClassNotFound
from sphinx.application import Sphinx
from sphinx.util import logging

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
LINK = re.compile(r"(?<=\]\()(?!https?:|mailto:|#)([^)\s#]+)(?:#L(\d+))?(?=\))")

project = "uuv-fleet"
author = "the uuv-fleet authors"
project_copyright = "the uuv-fleet authors, Apache-2.0"
version = release = installed("uuv-fleet")

extensions = ["myst_parser"]
exclude_patterns = ["_build", "examples"]
source_suffix = {".md": "markdown"}
myst_heading_anchors = 4
myst_url_schemes = ["http", "https", "mailto", "source"]
highlight_language = "none"

html_theme = "furo"
html_title = "uuv-fleet"
html_copy_source = False
html_show_sphinx = False
html_static_path = ["_static"]
html_css_files = ["boxes.css"]
html_show_search_summary = False  # excerpts are fetched, which a browser refuses for pages opened as files

sys.path.insert(0, str(DOCS))
import notebooks  # noqa: E402  of this folder

logger = logging.getLogger(__name__)
linked: set[str] = set()  # files of the repository that pages link to


def mark_links(app: Sphinx, docname: str, source: list[str]) -> None:
    """Write links to files that are no pages as `source:PATH#L12`; a missing file or line is a warning."""
    folder = Path(app.env.doc2path(docname)).parent

    def mark(match: re.Match[str]) -> str:
        path = Path(os.path.normpath(folder / match[1]))
        if path.suffix in {".md", ".png", ".svg", ".gif"} and path.is_relative_to(DOCS):
            return match[0]
        name = os.path.relpath(path, ROOT)
        if not path.is_file():
            logger.warning("link to %s, which does not exist", match[1], location=docname)
            return match[0]
        if match[2] and int(match[2]) > len(path.read_text("utf-8").splitlines()):
            logger.warning("link to line %s of %s, which is shorter", match[2], match[1], location=docname)
        linked.add(name)
        return f"source:{name}" + (f"#L{match[2]}" if match[2] else "")

    source[0] = LINK.sub(mark, source[0])


def offer_notebook(app: Sphinx, docname: str, source: list[str]) -> None:
    """Below what a lesson needs, lead to its notebook."""
    folder, _, name = docname.rpartition("/")
    if folder == "learn" and name != "index":
        link = f'<p><a href="{name}.ipynb" download>Download this lesson as a notebook</a> for Jupyter.</p>'
        source[0] = re.sub(r"(?<=\n\n)(?=## )", f"{link}\n\n", source[0], count=1)


def write_notebooks(app: Sphinx, error: Exception | None) -> None:
    """Put the notebooks beside the lessons; their links to pages lead to the site's."""
    if error is None and app.builder.name == "html":
        for path in notebooks.write(Path(app.outdir) / "learn", pages_end=".html"):
            logger.info("notebook %s", path.name)


def point_links(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Let links to `source:PATH#L12` lead to the listing of the file."""
    for node in doctree.findall(nodes.reference):
        if node.get("refuri", "").startswith("source:"):
            name, _, line = node["refuri"].removeprefix("source:").partition("#L")
            uri = app.builder.get_relative_uri(docname, f"source/{name}")
            node["refuri"] = uri + (f"#L-{line}" if line else "")


def listings(app: Sphinx) -> Iterator[tuple[str, dict[str, Any], str]]:
    """A page for each file that some page links to, with an anchor at each line."""
    for name in sorted(linked):
        try:
            lexer = get_lexer_for_filename(name)
        except ClassNotFound:
            lexer = TextLexer()
        code = highlight((ROOT / name).read_text("utf-8"), lexer, HtmlFormatter(lineanchors="L", linenos="inline"))
        yield (
            f"source/{name}",
            {"title": name, "body": f"<h1>{escape(name)}</h1><div class='listing'>{code}</div>"},
            "page.html",
        )


def setup(app: Sphinx) -> None:
    """Connect the two additions."""
    app.connect("source-read", mark_links)
    app.connect("source-read", offer_notebook)
    app.connect("build-finished", write_notebooks)
    app.connect("doctree-resolved", point_links)
    app.connect("html-collect-pages", listings)
