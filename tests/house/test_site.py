"""The documentation as a site: it builds, every link is in place, code fits its boxes, and the search finds words."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from browser import SIZE, SOON_S, browser
from repository import ROOT
from shared import alone

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec("sphinx") is None, reason="the extra [docs] is not installed"),
    pytest.mark.timeout(300),  # it takes half a minute to build
]
# Words that a stranger types, and a page that has to be among the first twelve.
WORDS = {
    "packet loss": "The network between the agents",
    "latency": "Terms",
    "acoustic modem": "The acoustic channel",
    "drift": "Clocks",
    "DVL": "Navigation",
    "ROS 2": "ROS 2",
    "Monte Carlo": "5. Where does it break?",
    "tutorial": "Terms",
}


# Runs sphinx as if the modules that are its first argument were not installed.
WITHOUT = """
import sys
for name in sys.argv.pop(1).split(","):
    sys.modules[name] = None
from sphinx.cmd.build import main
sys.exit(main(sys.argv[1:]))
"""


def modules_beyond_docs() -> set[str]:
    """The modules of the extras that `pip install '.[docs]'` leaves out."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]

    def packages(requirements: list[str]) -> set[str]:
        found: set[str] = set()
        for requirement in requirements:
            if match := re.match(r"uuv-fleet\[(.*)]", requirement):
                found.update(*(packages(extras[name]) for name in match[1].split(",")))
            elif match := re.match(r"[\w.-]+", requirement):
                found.add(match[0].lower())
        return found

    left_out = packages(extras["all"]) - packages(extras["docs"]) - packages(project["dependencies"])
    return {name for name, of in packages_distributions().items() if left_out & {each.lower() for each in of}}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built with the packages of the extra [docs] alone.

    A link that leads nowhere is a warning, and `-W` makes it an error.
    """
    with alone(tmp_path_factory, "site") as made:
        if not made.is_dir():
            part = tmp_path_factory.mktemp("part")
            sphinx = [sys.executable, "-c", WITHOUT, ",".join(modules_beyond_docs()), "-q", "-W", "--keep-going"]
            command: list[str | Path] = [*sphinx, "-d", part / "cache", "docs", part / "site"]
            done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=280, check=False)
            assert done.returncode == 0, done.stdout + done.stderr
            (part / "site").rename(made)
    return made


def test_every_page_is_there_and_nothing_is_fetched(site: Path) -> None:
    pages = {path.relative_to(site): path.read_text("utf-8") for path in site.rglob("*.html")}
    for page in (ROOT / "docs").rglob("*.md"):
        if "_build" not in page.parts:
            assert page.relative_to(ROOT / "docs").with_suffix(".html") in pages
    fetched = re.compile(r"<(?:script|img|iframe)[^>]*src=\"(?:https?:)?//|<link[^>]*href=\"(?:https?:)?//")
    assert [str(name) for name, text in pages.items() if fetched.search(text)] == []


def test_the_reference_of_python_has_names_and_comments(site: Path) -> None:
    api = (site / "reference" / "api.html").read_text("utf-8")
    for name in ("open_log", "Log", "Sample", "Controller"):
        assert f'<code class="docutils literal notranslate"><span class="pre">{name}</span></code>' in api
    assert "own measured x, y, z [m, NED], theta, psi [rad]" in api  # the comment behind a field
    assert "Alias for field number" not in api


def test_each_lesson_offers_its_notebook(site: Path) -> None:
    lessons = [path for path in (site / "learn").glob("*.html") if path.stem != "index"]
    assert len(lessons) == len([*(ROOT / "docs" / "learn").glob("[0-9]*.md")]) > 10
    for path in lessons:
        assert f'href="{path.stem}.ipynb" download' in path.read_text("utf-8")
        notebook = path.with_suffix(".ipynb").read_text("utf-8")
        for link in re.findall(r"\]\((?!https?:|#)([^)#\s]+)", notebook):
            assert (path.parent / link).exists(), link


def test_code_fits_its_box(site: Path) -> None:
    """A line that is longer than its box goes on below: readers need not scroll sideways, and copy whole lines."""
    cut, boxes = [], 0
    with browser() as opened:
        page = opened.new_page(viewport=SIZE)
        for path in sorted(site.rglob("*.html")):
            if "source" in path.relative_to(site).parts:
                continue
            page.goto(path.as_uri())
            wide = page.evaluate(
                "[...document.querySelectorAll('.content pre')].map(box => box.scrollWidth > box.clientWidth)"
            )
            boxes += len(wide)
            cut += [str(path.relative_to(site))] * sum(wide)
    assert boxes > 200
    assert cut == []


def test_the_search_finds_the_words_of_a_stranger(site: Path) -> None:
    with browser() as opened:
        page = opened.new_page(viewport=SIZE)
        page.set_default_timeout(1000 * SOON_S)
        for words, expected in WORDS.items():
            page.goto((site / "search.html").as_uri() + "?q=" + words.replace(" ", "+"))
            page.locator("p.search-summary:text-matches('found|did not match', 'i')").wait_for()
            found = page.locator("ul.search li > a").all_inner_texts()
            assert expected in found[:12], f"{words}: {found}"
