"""The command `fleet movie`."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from in_process_runs import Alone
from PIL import Image
from tool import invoke

SHORT = ("duration=1 s", "faults=[{at: 400 ms, for: 400 ms, id: cut, partition: halves}]", "checks={tumbled: waived}")
called = partial(invoke, "movie")


def test_it_prints_the_file_and_replaces_nothing_without_force(alone: Alone, tmp_path: Path) -> None:
    run, out = alone("paper", *SHORT).directory, tmp_path / "a.gif"
    options = ("-o", out, "--fps", "2", "--width", "327", "--from", "500ms")
    found = called(run, *options)
    assert (found.exit_code, found.stdout) == (0, f"{out}\n"), found.output
    with Image.open(out) as movie:
        assert (movie.size, movie.n_frames) == ((320, 240), 2)
    refused = called(run, *options)
    assert refused.exit_code == 2 and "replace it with --force" in refused.stderr
    assert called(run, *options, "--force", "--view", "3d").exit_code == 0


def test_a_log_that_is_cut_is_drawn_and_said_to_be_cut(alone: Alone, tmp_path: Path) -> None:
    whole, cut = alone("paper", *SHORT).directory / "run.mcap", tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:-20])
    found = called(cut, "-o", tmp_path / "a.gif", "--fps", "1", "--width", "320")
    # On a busy machine the line of progress comes before it.
    told = [line for line in found.stderr.splitlines() if not line.startswith("drawing ")]
    assert found.exit_code == 0 and told[0].startswith(f"fleet: {cut}: "), found.output
    assert (tmp_path / "a.gif").exists()
