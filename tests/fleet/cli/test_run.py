"""`fleet run`: its options for faults and links, and what it prints for scripts."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner, Result

from fleet.cli.main import cli

QUICK = ["--in-process", "--duration", "500 ms", "--set", "checks={}", "-q"]
WORDS = ["--fault", "at 100ms for 200ms partition halves", "--net", "* loss 20%", "--net", "1->2 down"]


def invoke(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [str(argument) for argument in arguments], prog_name="fleet")


def test_faults_and_links_in_words_become_part_of_the_run(tmp_path: Path) -> None:
    """Of its merged scenario, so that verify and script know them."""
    assert invoke("run", "paper", *QUICK, *WORDS, "--out", tmp_path).exit_code == 0
    assert invoke("verify", "-q", tmp_path / "latest").stdout.startswith("reproduced bit for bit")
    shown = invoke("run", "paper", *QUICK, *WORDS, "--show-config").stdout
    assert (tmp_path / "latest" / "scenario.yaml").read_text() == shown
    assert invoke("script", tmp_path / "latest").stdout.count("partition: halves") == 1


def test_check_takes_the_same_words() -> None:
    result = invoke("check", "paper", *WORDS)
    assert result.exit_code == 0
    assert "fault f1: partition halves, 0.1 to 0.3 s" in result.stdout
    wrong = invoke("check", "paper", "--fault", "at 5s kil 3", "--net", "1->9 down")
    assert wrong.exit_code == 2
    assert '\n--fault at 5s kil 3: no fault is called "kil"' in wrong.stderr
    assert "fleet: --net 1->9 down: network.links.1->9: the graph has no such link" in wrong.stderr
