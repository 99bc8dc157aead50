"""What the file of a picture says of itself, and how it is made."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

import matplotlib
import pytest
from in_process_runs import Alone
from PIL import Image
from repository import ROOT

from fleet.addons.pictures.gallery import write
from fleet.addons.pictures.look import COLUMN_IN, LABEL_PT, LEGEND_PT, TEXT_PT
from fleet.addons.pictures.runs import View, load
from fleet.mcap.reader import digest


@pytest.fixture(scope="module")
def directory(made: Alone) -> Path:
    return made("ideal", "duration=200 ms", "checks={}", "seed=7").directory


def test_a_file_says_scenario_seed_and_digest(directory: Path, tmp_path: Path) -> None:
    """In PNG's text, PDF's information and SVG's Dublin Core; 300 dpi; the same bytes every time, so without a date."""
    for folder in ("a", "b"):
        runs = load([directory])
        write(["formation"], runs, View(), tmp_path / folder, ("png", "svg", "pdf"), print)
    told = digest(directory / "run.mcap")
    with Image.open(tmp_path / "a" / "formation.png") as image:
        assert image.info["dpi"] == pytest.approx((300, 300), abs=0.1)
        assert image.size[0] == COLUMN_IN * 300
        assert {image.info["Scenario"], image.info["Seed"], image.info["Digest"]} == {"ideal", "7", told}
        assert image.info["Title"].startswith("Distance")
    svg = (tmp_path / "a" / "formation.svg").read_text()
    assert f"<dc:description>scenario ideal, seed 7, digest {told}</dc:description>" in svg
    assert f"<rdf:li>digest={told}</rdf:li>" in svg
    pdf = (tmp_path / "a" / "formation.pdf").read_bytes()
    streams = b"".join(
        zlib.decompressobj().decompress(part) for part in re.findall(rb"stream\r?\n(x.*?)endstream", pdf, re.S)
    )
    assert f"digest {told}".encode() in pdf + streams
    for form in ("png", "svg", "pdf"):
        assert (tmp_path / "a" / f"formation.{form}").read_bytes() == (
            tmp_path / "b" / f"formation.{form}"
        ).read_bytes()


def test_one_typography() -> None:
    """Whoever draws sets no size of his own."""
    assert matplotlib.rcParams["font.size"] == TEXT_PT > LEGEND_PT > LABEL_PT >= 6.0
    for path in (ROOT / "fleet/addons").rglob("*.py"):
        assert not re.search(r"font_?size=\s*[0-9]", path.read_text()), path
