"""The lessons of docs/learn: each is done as a reader would do it, and shows what its commands print."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from repository import ROOT
from waiting import wait_for

SOON_S = 60.0  # only bounds a hang
_spec = importlib.util.spec_from_file_location("notebooks", ROOT / "docs" / "notebooks.py")
assert _spec is not None and _spec.loader is not None
notebooks = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(notebooks)
LESSONS = {page.stem: page for page in notebooks.lessons()}
NEEDS = {
    "4-why": "2-your-program",
    "5-where-does-it-break": "2-your-program",
    "10-one-real-vehicle": "2-your-program",
}  # a lesson that goes on with the files of another
EXTRAS = {"5-where-does-it-break": "pandas", "6-your-protocol": "pandas", "7-your-own-stack": "pandas",
          "9-your-modem-code": "unetpy", "11-watch-it-live": "nicegui", "12-ros2": "rosbags"}  # fmt: skip

ON_THE_WALL_CLOCK = ("7-your-own-stack", "10-one-real-vehicle")  # they wait more than a minute

# A command that ends with 2 or more ends the box: 1 is a failed check, which some lessons are about.
STRICT = "trap 's=$?; [ $s -lt 2 ] || exit $s' ERR\n"


class Reader:
    """Types what a lesson says, in a folder, and keeps what comes out."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        runtime = folder.with_name("runtime")
        runtime.mkdir()
        self._environment = os.environ | {
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
            "BROWSER": "true",  # opens nothing
            "COLUMNS": "120",
            "ROS_DOMAIN_ID": str(1 + os.getpid() % 200),  # tests at the same time are not heard
            "XDG_RUNTIME_DIR": str(runtime),  # nor their live runs seen
        }
        self._left_open: list[subprocess.Popen[bytes]] = []
        self._names: dict[str, Any] = {}

    def do(self, cell: Any) -> tuple[str, ...]:
        """Do what a cell says; returns its output, by stream."""
        if cell.kind == "file":
            (self._folder / cell.name).write_text(cell.text, "utf-8")
            return ("",)
        if cell.kind == "code":
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed), contextlib.chdir(self._folder):
                exec(cell.text, self._names)
            return (printed.getvalue(),)
        if cell.kind == "background":
            return (self._leave_open(cell.text, cell.shown),)
        done = subprocess.run(
            ["bash", "-c", STRICT + cell.text],
            cwd=self._folder, env=self._environment, capture_output=True, text=True, timeout=280, check=False,
        )  # fmt: skip
        assert done.returncode < 2 and "Traceback" not in done.stderr, f"{cell.text}{done.stdout}{done.stderr}"
        return done.stdout, done.stderr

    def _leave_open(self, text: str, shown: str) -> str:
        """Begin commands that go on; returns their output once it has what the lesson shows."""
        output = self._folder.with_name(f"terminal-{len(self._left_open)}.txt")
        with output.open("w", encoding="utf-8") as out:
            process = subprocess.Popen(
                ["bash", "-c", text], cwd=self._folder, env=self._environment, start_new_session=True,
                stdout=out, stderr=subprocess.STDOUT,
            )  # fmt: skip
        self._left_open.append(process)
        ready = self._a_run_answers if re.search("fleet (run|netem)", text) else lambda: True

        def begun() -> bool:
            missing = first_missing(shown, (output.read_text("utf-8"),))
            return process.poll() is not None or (not missing and ready())

        wait_for(begun, SOON_S, f"the output of {text}")
        return output.read_text("utf-8")

    def _a_run_answers(self) -> bool:
        asked = subprocess.run(
            ["fleet", "status", "--json"], cwd=self._folder, env=self._environment, capture_output=True, check=False
        )
        return asked.returncode == 0 or b"not ready yet" in asked.stderr  # it waits for an agent from outside

    def close(self) -> None:
        for process in reversed(self._left_open):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
            process.wait(SOON_S)


@pytest.fixture
def reader(tmp_path: Path) -> Iterator[Reader]:
    (tmp_path / "empty").mkdir()
    done = Reader(tmp_path / "empty")
    yield done
    done.close()


def first_missing(shown: str, streams: tuple[str, ...]) -> str:
    """The first line that a lesson shows and that no stream has, in this order; empty: all are there."""
    left = [[line.rstrip() for line in stream.replace("\r", "\n").splitlines()] for stream in streams]
    for line in shown.splitlines():
        if line.strip() == "...":
            continue
        pattern = re.compile(".*".join(re.escape(part) for part in line.rstrip().split("...")))
        for stream in left:
            at = next((k for k, found in enumerate(stream) if pattern.fullmatch(found)), None)
            if at is not None:
                del stream[: at + 1]
                break
        else:
            return line
    return ""


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.timeout(400 if name in ON_THE_WALL_CLOCK else 300)) for name in LESSONS],
)
def test_a_lesson_can_be_done(name: str, reader: Reader) -> None:
    if name in EXTRAS:
        pytest.importorskip(EXTRAS[name], reason="an extra is not installed")
    if name in NEEDS:
        for cell in notebooks.cells(LESSONS[NEEDS[name]]):
            if cell.kind == "file":
                reader.do(cell)
    for cell in notebooks.cells(LESSONS[name]):
        if cell.kind != "words":
            streams = reader.do(cell)
            missing = first_missing(cell.shown, streams)
            assert not missing, f"{name}, line {cell.line}: {missing!r} is not in\n{''.join(streams)}"


def test_the_program_of_the_readme_can_be_run(reader: Reader, tmp_path: Path) -> None:
    """It fails as the README shows, for the reason that it gives."""
    page = tmp_path.with_name("readme.md")
    page.write_text(
        (ROOT / "README.md").read_text("utf-8").partition("## Your program")[2].partition("\n## ")[0], "utf-8"
    )
    cells = [cell for cell in notebooks.cells(page) if cell.kind != "words"]
    assert [cell.kind for cell in cells] == ["file", "file", "commands"]
    for cell in cells:
        streams = reader.do(cell)
    assert not (missing := first_missing(cells[-1].shown, streams)), f"{missing!r} is not in {''.join(streams)}"


@pytest.mark.parametrize("name", LESSONS)
def test_a_lesson_says_what_it_needs_and_what_one_has_made(name: str) -> None:
    text = LESSONS[name].read_text("utf-8")
    assert re.search(r"^\*\*You need\*\*: .* min", text, re.MULTILINE)
    assert "\n## What you have made\n" in text


def test_the_notebooks_are_valid_and_have_every_box(tmp_path: Path) -> None:
    for path, page in zip(notebooks.write(tmp_path), LESSONS.values(), strict=True):
        made = json.loads(path.read_text("utf-8"))
        sources = "".join(cell["source"] for cell in made["cells"])
        for box in re.findall(r"^```(?:sh|python|yaml)\n(.*?)^```", page.read_text("utf-8"), re.MULTILINE | re.DOTALL):
            assert box.strip() in sources
        for link in re.findall(r"\]\((?!https?:|#)([^)#\s]+)", sources):
            assert (tmp_path / link).exists(), link
        if importlib.util.find_spec("nbformat") is not None:
            import nbformat

            nbformat.validate(nbformat.from_dict(made))
