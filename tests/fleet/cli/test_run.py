"""`fleet run`: its options for faults and links, and what it prints for scripts."""

from __future__ import annotations

import json
import re
from pathlib import Path

import click
import pytest
from tool import invoke

QUICK = ["--in-process", "--duration", "500 ms", "--set", "checks={}", "-q"]
WORDS = ["--fault", "at 100ms for 200ms partition halves", "--net", "* loss 20%", "--net", "1->2 down"]


def test_faults_and_links_in_words_become_part_of_the_run(tmp_path: Path) -> None:
    """Of its merged scenario, so that verify and script know them."""
    assert invoke("run", "paper", *QUICK, *WORDS, "--out", tmp_path).exit_code == 0
    assert invoke("verify", "-q", tmp_path / "latest").stdout.startswith("reproduced bit for bit")
    shown = invoke("run", "paper", *QUICK, *WORDS, "--show-config").stdout
    assert (tmp_path / "latest" / "scenario.yaml").read_text() == shown
    assert invoke("export", tmp_path / "latest", "--scenario").stdout.count("partition: halves") == 1


def test_check_takes_the_same_words() -> None:
    result = invoke("check", "paper", *WORDS)
    assert result.exit_code == 0
    assert "fault from 0.1 to 0.3 s: partition halves (id f1)" in result.stdout


# --- log: none ------------------------------------------------------------------

NO_LOG = ["--set", "log=none"]


def test_a_run_without_a_log_has_its_result_and_the_same_digest(tmp_path: Path) -> None:
    logged = Path(invoke("run", "paper", *QUICK, *WORDS, "--out", tmp_path).stdout.strip())
    without = Path(invoke("run", "paper", *QUICK, *WORDS, *NO_LOG, "--out", tmp_path).stdout.strip())
    assert {path.name for path in without.iterdir()} == {"log", "result.json", "scenario.yaml"}
    a, b = (json.loads((directory / "result.json").read_text()) for directory in (logged, without))
    assert (a.pop("log_bytes") > 0, b.pop("log_bytes")) == (True, 0)
    del a["wall"], b["wall"]
    assert a == b
    assert "log: none" in (without / "scenario.yaml").read_text().splitlines()
    again = Path(invoke("run", without / "scenario.yaml", *QUICK, "--set", "log={}", "--out", tmp_path).stdout.strip())
    assert (again / "run.mcap").read_bytes() == (logged / "run.mcap").read_bytes()


def test_a_run_without_a_log_says_so(tmp_path: Path) -> None:
    result = invoke("run", "paper", *QUICK[:-1], *NO_LOG, "--out", tmp_path)
    assert re.search(r" messages, no log, digest [0-9a-f]{16}$", result.stdout, re.MULTILINE)


def test_what_needs_a_log_says_that_there_is_none(tmp_path: Path) -> None:
    run = Path(invoke("run", "paper", *QUICK, *NO_LOG, "--out", tmp_path).stdout.strip())
    for command in (
        ["info", run], ["verify", run], ["plot", run], ["export", run, "--csv", tmp_path / "csv"], ["recover", run],
        ["export", run, "--scenario"], ["whatif", run, "--agent", "1"], ["run", "--from", run], ["diff", run, run],
        ["report", run, "-o", tmp_path / "r.html"], ["replay", run], ["info", run / "run.mcap"],
    ):  # fmt: skip
        result = invoke(*command)
        assert result.exit_code == 2, command
        assert f"fleet: {run} has no log, as its scenario says log: none; " in result.stderr, command
        assert f"fleet run {run}/scenario.yaml --set log={{}}" in result.stderr
    (run / "scenario.yaml").unlink()
    assert "cannot read" in invoke("info", run).stderr


def test_a_published_run_without_a_log(tmp_path: Path) -> None:
    """What is published does not depend on the log."""
    result = invoke("run", "paper", *QUICK, *NO_LOG, "--publish", "--out", tmp_path)
    assert result.exit_code == 0, result.stderr
    values = json.loads((tmp_path / "latest" / "result.json").read_text())
    assert (values["log_bytes"], values["published"]["dropped"]) == (0, 0)


# --- the fork server --------------------------------------------------------------


def test_the_fork_server_imports_while_the_scenario_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only where there will be processes, as far as that is known before the scenario is."""
    done: list[str] = []
    monkeypatch.setattr("fleet.processes.children.start_forkserver", lambda: done.append("started"))
    for options, expected in (([], ["started", "read"]), (["--in-process"], ["read"]), (["--show-config"], ["read"])):
        done.clear()
        monkeypatch.setattr("fleet.scenario.loading.load_scenario", lambda *_, **__: done.append("read") or _refuse())
        result = invoke("run", "paper", *options, "--out", tmp_path)
        assert (result.exit_code, done) == (2, expected)


def _refuse() -> None:
    raise click.UsageError("no such scenario")
