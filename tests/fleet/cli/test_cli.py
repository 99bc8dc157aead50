"""The command line: what it says, where, with which status, and what a run leaves behind."""

from __future__ import annotations

import errno
import json
import os
import re
import sqlite3
import subprocess
import sys
from collections import Counter
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from repository import EXPECTED, ROOT
from rich.console import Console as Terminal
from screens import assert_screen
from tool import commands, invoke

import fleet
from fleet.__main__ import _command_line
from fleet.addons.studies.catalogue import shipped_studies
from fleet.cli.group import report
from fleet.errors import FleetError
from fleet.mcap.reader import digest
from fleet.recorder.log_file import LogError
from fleet.scenario.catalogue import list_scenarios
from fleet.scenario.loading import load_scenario
from fleet.scenario.schema.groups import GROUPS

SHIPPED = [row.name for row in list_scenarios()]


QUICK = ["--in-process", "--duration", "500 ms"]
NO_CHECKS = ["--set", "checks={}"]


def shell(*arguments: str | Path, script: bool = False, **environment: str) -> Any:
    """The command line as a user starts it: as a module, or by the script that was installed."""
    command = [str(Path(sys.executable).with_name("fleet"))] if script else [sys.executable, "-m", "fleet"]
    return subprocess.run(
        [*command, *map(str, arguments)],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )


# --- help ------------------------------------------------------------------


@pytest.mark.parametrize("command", ["", "run", "check", "inject", "view", "plot", "sweep", "boundary"])
def test_help(command: str) -> None:
    """What these say of themselves is a contract that a change must show in a diff. To renew one:
    COLUMNS=100 fleet run --help > tests/expected/help-run.txt"""
    result = invoke(*command.split(), "--help")
    assert result.exit_code == 0
    assert result.output == (EXPECTED / f"help-{command.replace(' ', '-') or 'fleet'}.txt").read_text("utf-8")


def test_python_dash_m() -> None:
    """`fleet` and `python -m fleet` are the same, and say so to who asks for help."""
    script = shell("--help", script=True, COLUMNS="100")
    module = shell("--help", COLUMNS="100")
    assert (module.returncode, module.stderr) == (0, "")
    assert module.stdout.replace("python -m fleet", "fleet") == script.stdout


def test_every_help_has_an_example_and_explains_every_option() -> None:
    """An example where a command takes anything but --help and --json; a group lists its commands instead."""
    for name, command in commands().items():
        result = invoke(*name.split(), "--help")
        assert result.exit_code == 0
        options = result.output.count("\n  --") + result.output.count("\n  -")
        if options > 3 and "\nCommands:" not in result.output:
            assert f"\n    fleet {name}" in result.output
        for parameter in command.params:
            told = getattr(parameter, "hidden", False) or getattr(parameter, "help", None)
            assert parameter.param_type_name == "argument" or told, (name, parameter.name)


def test_version() -> None:
    cores = r"(compiled|plain Python \((at the installation: .+|these are sources, as an editable install uses them)\))"
    assert re.fullmatch(rf"fleet, version \d+\.\d+\.\d+(\.dev\d+)?, cores: {cores}\n", invoke("--version").output)


def test_a_title_that_begins_with_the_same_follows_what_it_is_the_same_as() -> None:
    """`fleet list` shows the scenarios of a group by name, each with its title."""
    for before, one in pairwise(sorted(list_scenarios(), key=lambda one: (one.group, one.name))):
        if one.title.startswith("The same"):
            assert one.name.startswith(before.name), f"{one.name} is listed after {before.name}"


# --- exit status -----------------------------------------------------------

# A force whose speed has no finite square.
RUNAWAY = ["--set", "faults=[{at: 100 ms, wrench: {force: 1e200 1e200 0 N}}]", "--set", "on_death=abort"]


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["run", "paper", *QUICK, *NO_CHECKS], 0, ""),
        (
            ["run", "paper", *QUICK, "--set", "checks.formation_error={below: 1 mm}"],
            1,
            "FAIL  formation_error: below 0.0",
        ),
        (["run", "paper", "--speeed", "2"], 2, "No such option '--speeed'"),
        (["run", "paper", "--set", "durration=5 s"], 2, "duration"),
        (["run", "paper", *QUICK, *NO_CHECKS, *RUNAWAY], 3, "vehicle 1, tick "),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_exit_status(arguments: list[str], status: int, said: str, tmp_path: Path) -> None:
    """0 pass, 1 a check failed, 2 usage or bad scenario, 3 the run broke; with the reason on stderr, never a
    traceback. (130 is with the interrupts, 3 for each way to die with the deaths, and more of 2 in test_mistakes.)"""
    place = ["--out", str(tmp_path), "--quiet"] if arguments[0] == "run" and len(arguments) > 1 else []
    done = invoke(*arguments, *place)
    found, stdout, stderr = done.exit_code, done.stdout, done.stderr
    assert found == status, stderr
    assert said in stderr
    assert bool(said) == bool(stderr)
    assert "Traceback" not in stderr
    ran = arguments[0] == "run" and list(tmp_path.glob("*/result.json"))
    assert stdout == (f"{(tmp_path / 'latest').resolve()}\n" if ran else "")


@pytest.mark.parametrize("more", [b"", b"\xff" * 100])
def test_the_mere_beginning_of_a_log_is_a_log_cut_short(more: bytes, tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"\x89MCAP0\r\n" + more)
    result = invoke("info", tmp_path / "x.mcap")
    assert result.exit_code == 0 and "NOT WHOLE" in result.stdout


def test_a_reader_that_has_seen_enough() -> None:
    """`fleet protocol | head -1` ends in silence."""
    with subprocess.Popen(
        [sys.executable, "-m", "fleet", "protocol"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(60) in (0, 1, 141)


# --- scenarios -------------------------------------------------------------


def test_list_names_every_scenario_and_study() -> None:
    result = invoke("list")
    assert (result.exit_code, result.stderr) == (0, "")
    rows = re.findall(r"^  (\S+) ", result.stdout, re.MULTILINE)
    assert sorted(rows) == SHIPPED and rows[0] == "paper"
    headings = [line.strip() for line in result.stdout.splitlines() if line[:1].isalpha()]
    assert headings[1:7] == list(GROUPS)
    assert re.findall(r"^(\S+) ", "\n".join(headings[7:]), re.MULTILINE) == ["study", *shipped_studies()]


CHECKED = ("paper", "breakdown", "acoustic-80bps")  # one of each kind; the others are slow


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in CHECKED else [pytest.mark.slow]) for name in SHIPPED]
)
def test_check_accepts_what_ships(name: str) -> None:
    result = invoke("check", name)
    assert result.exit_code == 0
    if name == "breakdown":  # theory expects what it is there to show
        assert "the formation is not kept" in result.stderr
    else:
        assert result.stderr == ""
    assert result.stdout.startswith(f"{name}: valid. {load_scenario(name).vehicles} vehicles, ")


@pytest.mark.parametrize("name", ["paper", "rough-sea", "acoustic-80bps", "nemesis"])
def test_shown_configuration_loads_again(name: str, tmp_path: Path) -> None:
    """--show-config prints the whole truth: the file it makes is the same scenario, with the overrides in it, and
    shows as itself. Nothing is run and nothing written."""
    overrides = ["--seed", "7", "--duration", "9 s", "--set", "checks={}"]
    first = invoke("run", name, *overrides, "--show-config", "--out", tmp_path / "runs")
    assert (first.exit_code, first.stderr) == (0, "")
    file = tmp_path / "shown.yaml"
    file.write_text(first.stdout)
    assert invoke("run", file, "--show-config").stdout == first.stdout
    assert load_scenario(file) == load_scenario(name, ["seed=7", "duration=9 s", "checks={}"])
    assert list(tmp_path.iterdir()) == [file]


# --- what a run leaves behind ----------------------------------------------


def run(out: Path, *arguments: str | Path) -> Path:
    """A quiet run that passes; its directory."""
    result = invoke("run", *arguments, "--out", out, "--quiet")
    directory = (out / "latest").resolve()
    assert (result.exit_code, result.output) == (0, f"{directory}\n"), result.output
    return directory


def files(directory: Path) -> set[str]:
    return {str(path.relative_to(directory)) for path in directory.rglob("*") if path.is_file()}


def test_run_directory(tmp_path: Path) -> None:
    """Exactly what docs/reference/run.md lists; `latest` is a relative link to the newest, so the place may move."""
    out = tmp_path / "deep" / "runs"
    first = run(out, "paper", "--duration", "500 ms", *NO_CHECKS)
    processes = {f"log/{role}.log" for role in ("world", "netem", "agent-1", "agent-2", "agent-3", "agent-4")}
    assert files(first) == {"scenario.yaml", "run.mcap", "result.json", *processes}
    assert re.fullmatch(r"paper-1-\d{8}-\d{6}", first.name)
    second = run(out, "paper", *QUICK, "--seed", "5", *NO_CHECKS)
    assert files(second) == {"scenario.yaml", "run.mcap", "result.json"}
    assert second.name.startswith("paper-5-")
    assert os.readlink(out / "latest") == second.name
    assert {path.name for path in out.iterdir()} == {first.name, second.name, "latest"}


def test_runs_in_the_same_second_do_not_meet(tmp_path: Path) -> None:
    directories = {run(tmp_path, "paper", *QUICK, *NO_CHECKS) for _ in range(3)}
    assert len(directories) == 3


def test_scenario_file_repeats_the_run(tmp_path: Path) -> None:
    """What lies beside a log is all that one needs to make the same log again, byte for byte."""
    first = run(tmp_path, "rough-sea", *QUICK, "--seed", "3", *NO_CHECKS)
    second = run(tmp_path, first / "scenario.yaml", "--in-process")
    assert first != second
    assert (first / "run.mcap").read_bytes() == (second / "run.mcap").read_bytes()
    assert (first / "scenario.yaml").read_text() == (second / "scenario.yaml").read_text()


def test_result_file(tmp_path: Path) -> None:
    """The structure that scripts rely on, with numbers that agree with the log and with each other."""
    directory = run(tmp_path, "rough-sea", "--duration", "2 s", "--set", "checks={ledger: balanced}")
    values = json.loads((directory / "result.json").read_text())
    named = [field.encode_name for field in msgspec.structs.fields(fleet.Result)]  # which docs/reference/json.md lists
    assert ["run", "directory", *values] == named
    assert (values["scenario"], values["seed"], values["from_s"], values["sim_s"]) == ("rough-sea", 1, 0.0, 2.0)
    assert (values["status"], values["exit"], values["reason"], values["lines"]) == ("pass", 0, "", [])
    assert [check["check"] for check in values["checks"]] == ["tumbled", "deaths", "qp_infeasible", "ledger"]
    assert values["checks"][-1] == {
        "check": "ledger",
        "passed": True,
        "asked": "balanced",
        "found": "balanced",
        "value": 0,
        "limit": 0,
        "unit": "links",
        "moment": None,
        "signals": [],
        "margin": {"value": 0, "at_s": None, "unit": "links"},
        "reached": None,
        "judged": True,
    }
    assert list(values["vehicles"]) == ["1", "2", "3", "4"]
    assert set(values["ledger"]) == {"1->2", "2->3", "3->4"}
    for account in values["ledger"].values():
        assert account["sent"] == 20  # 10 Hz for 2 s
        assert account["sent"] == account["delivered"] + sum(account["lost"].values()) + account["in_flight"]
    assert sum(account["lost"].get("loss", 0) for account in values["ledger"].values()) > 0
    assert (values["middleware_lost"], values["rejected"], values["notes"]) == (0, {}, [])
    assert values["digest"] == digest(directory / "run.mcap")
    assert values["messages"] == sum(topics(directory / "run.mcap").values())
    assert set(values["wall"]) == {
        "in_process",
        "processes",
        "per_process",
        "startup_s",
        "run_s",
        "cpu_s",
        "cores",
        "machine",
        "x_real_time",
    }
    assert values["wall"]["in_process"] is False


def topics(log: Path) -> Counter[str]:
    with log.open("rb") as file:
        return Counter(channel.topic for _, channel, _ in make_reader(file).iter_messages())


WATER = "network={period: 100 ms, payload: located, acoustic: {modem: s2c-burst, tries: 0, ranging: one-way}}"
MORE = (
    *("--set", "navigation={gps: {depth: 1 km, period: 100 ms}}", "--set", "agent={clock: {}, localization: aid}"),
    *("--set", WATER),
)


@pytest.mark.parametrize(
    ("scenario", "more", "lacks"),
    [
        ("paper", (), {f"uuv/<i>/{group}" for group in ("plant", "clock", "belief", "fix", "located")}),
        ("remus", MORE, set()),
    ],
)
def test_log_opens_in_mcaps_own_reader_with_the_documented_topics(
    scenario: str, more: tuple[str, ...], lacks: set[str], tmp_path: Path
) -> None:
    """Every message decodes with the schema that the file carries, every topic is one of the page's, every one of the
    page's is there, and each field of ours has a unit and a meaning in the channel's metadata."""
    log = run(tmp_path, scenario, *QUICK, *NO_CHECKS, *more) / "run.mcap"
    page = (ROOT / "docs" / "reference" / "topics.md").read_text("utf-8")
    documented = set(re.findall(r"`((?:uuv|link)/<\w+>[^`]*)`", page))
    documented |= set(re.findall(r"^\| `(transforms)`, `(scene)` \|", page, re.MULTILINE)[0])
    assert len(documented) == 15
    documented -= lacks
    found: dict[str, set[str]] = {}
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            pattern = re.sub(r"^uuv/\d+/", "uuv/<i>/", re.sub(r"^link/\d+-\d+$", "link/<src>-<dst>", channel.topic))
            found.setdefault(pattern, set()).add(schema.name)
            units = json.loads(channel.metadata["units"])
            if schema.name.startswith("uuv_fleet."):
                assert set(units) == {field.name for field in decoded.DESCRIPTOR.fields}
            assert all(meaning for _, meaning in units.values())
            assert message.log_time >= message.publish_time or "link/" not in channel.topic
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = {record.name: record.data for record in reader.iter_attachments()}
    assert set(found) == documented
    assert {pattern: len(names) for pattern, names in found.items()} == dict.fromkeys(documented, 1)
    assert metadata["run"]["scenario"] == scenario
    assert attachments["scenario.yaml"] == (log.parent / "scenario.yaml").read_bytes()


def test_info_counts_what_the_log_holds(tmp_path: Path) -> None:
    directory = run(tmp_path, "paper", *QUICK, *NO_CHECKS)
    values = json.loads(invoke("info", directory, "--json").stdout)
    counted = {topic: count for topic, (_, count) in values["topics"].items() if count}
    assert counted == topics(directory / "run.mcap")
    assert (values["start_s"], values["end_s"], values["missing"]) == (0.0, 0.5, "")
    words = invoke("info", directory / "run.mcap").stdout
    assert words.splitlines()[0].endswith("sim time 0 to 0.5 s")
    assert "NOT WHOLE" not in words and "faults" not in words.splitlines()


def test_info_tells_faults_and_apart_from_them_what_happened_to_vehicles(tmp_path: Path) -> None:
    heavy = "vehicle={beta_b: 1 kN m, beta_q: 300 kg m^2/s, tumble_pitch: 10 deg}"
    wrench = '{id: push, at: 500 ms, for: 1 s, wrench: {vehicles: "2", pitch_moment: 300 N m}}'
    push = f'faults=[{wrench}, {{at: 500 ms, off: "2"}}]'
    directory = run(
        tmp_path,
        "paper",
        "--set",
        "duration=3 s",
        "--set",
        "checks={tumbled: {at_most: 1}}",
        "--set",
        heavy,
        "--set",
        push,
    )
    values = json.loads(invoke("info", directory, "--json").stdout)
    assert [(fault["id"], fault["from_s"], fault["to_s"]) for fault in values["faults"]] == [
        ("push", 0.5, 1.5),
        ("f2", 0.5, 3.0),
    ]
    (event,) = values["events"]
    assert (event["what"], event["times"]) == ("tumbled 2", 1)
    words = invoke("info", directory).stdout.splitlines()
    begin = words.index("faults")
    assert words[begin + 1].startswith("  push: 0.5 to 1.5 s: wrench {vehicles: 2")
    assert words[begin + 3 : begin + 5] == ["events of vehicles", f"  tumbled 2: at {event['first_s']:g} s"]
    result = json.loads((directory / "result.json").read_text())
    assert {row["fault"] for row in result["faults"]} == {"push", "f2"}
    assert {row["fault"] for row in result["events"]} == {"tumbled-2"}


# --- what is said ----------------------------------------------------------


def test_run_says_what_came_of_it(tmp_path: Path) -> None:
    """The tables go to stdout, complete, also where no terminal gives a width; talk goes to stderr."""
    done = shell("run", "rough-sea", *QUICK, "--out", tmp_path, "--set", "checks.ledger=balanced", COLUMNS="40")
    assert done.returncode == 1
    lines = [line.rstrip() for line in done.stdout.splitlines()]
    assert "packets per directed link, age of what was heard last" in lines
    assert any(line.startswith("not judged  formation_error: below 0.4 m after 60 s; found ") for line in lines)
    assert any(line.startswith("FAIL  ") and line.endswith(" not judged") for line in lines)
    assert "pass  ledger: balanced; found balanced" in lines
    assert lines[-1] == str((tmp_path / "latest").resolve())
    assert "\x1b" not in done.stdout


def test_ideal_network_says_that_it_runs_in_one_process(tmp_path: Path) -> None:
    """An option that is overruled is not overruled in silence."""
    done = invoke("run", "ideal", "--duration", "500 ms", "--out", tmp_path, *NO_CHECKS)
    assert done.exit_code == 0
    assert "network: ideal has no latency and so runs in one process" in done.stderr


def test_quiet_says_nothing_of_a_failure_that_is_meant(tmp_path: Path) -> None:
    short = ["--duration", "500 ms", "--out", tmp_path, "--quiet", "--set", "checks={formation_error: {below: 1 mm}}"]
    done = invoke("run", "ideal", *short, "--set", "expect=fail")
    assert (done.exit_code, done.stderr) == (0, "")
    failed = invoke("run", "ideal", *short)
    assert (failed.exit_code, "FAIL  formation_error" in failed.stderr) == (1, True)


@pytest.mark.parametrize(
    ("where", "error", "words"),
    [
        ("fleet.execution.execute.LivePublisher.open", FleetError("no port is free", status=3), "no port is free"),
        (
            "fleet.execution.execute.LogFile",
            LogError("cannot write the log: No space left on device"),
            "cannot write the log",
        ),
        ("pathlib.Path.write_text", OSError(errno.ENOSPC, "No space left on device"), "scenario.yaml: No space left"),
    ],
)
def test_what_the_machine_refuses_is_no_usage_error(
    where: str, error: Exception, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before the run begins, too: status 3 and a sentence."""

    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(where, refuse)
    result = invoke("run", "paper", "--in-process", "--publish", "--out", tmp_path)
    assert result.exit_code == 3 and words in result.stderr


def test_a_full_disk_is_no_usage_error() -> None:
    """Whatever of this package words it: any other place would be as full."""
    full, gone = OSError(errno.ENOSPC, "No space left on device", "a"), OSError(errno.ENOENT, "No such file", "a")
    database = sqlite3.OperationalError("database or disk is full")
    database.sqlite_errorcode = sqlite3.SQLITE_FULL
    for cause, status in ((full, 3), (gone, 2), (database, 3)):
        worded = FleetError("cannot write")
        worded.__context__ = cause  # as `raise ... from None` keeps it
        assert report(worded) == status
    assert (report(full), report(gone)) == (3, 2)


@pytest.mark.parametrize("error", [MemoryError(), ImportError("libarrow.so: failed to map segment")])
def test_a_library_that_finds_no_memory_is_no_traceback(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("fleet.cli.main.cli", fail)
    assert _command_line() == 3
    assert "enough memory" in capsys.readouterr().err


def test_a_run_is_no_scenario(tmp_path: Path) -> None:
    """Whoever names a run's directory, or its log, is told what would have been meant."""
    result = invoke("run", "ideal", *QUICK, *NO_CHECKS, "--out", tmp_path, "-q")
    assert result.exit_code == 0
    for path, words in (
        ("latest", "did you mean"),
        ("latest/run.mcap", "fleet run --from"),
        ("latest/log", "is a dir"),
    ):
        result = invoke("run", tmp_path / path)
        assert result.exit_code == 2 and words in result.stderr


def test_list_fits_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    out = StringIO()
    monkeypatch.setattr(
        "fleet.cli.runs.stdout", lambda: Terminal(file=out, width=80, force_terminal=True, no_color=True)
    )
    invoke("list")
    text = re.sub(r"\x1b\[\d*m", "", out.getvalue())
    assert_screen("list-80", "".join(f"{line.rstrip()}\n" for line in text.splitlines()))


def test_run_prints_the_faults_of_its_scenario(tmp_path: Path) -> None:
    """As fleet check does, also those that a nemesis draws; of very many, the first."""
    changes = [*NO_CHECKS, "--set", "nemesis={every: 20 ms, for: 10 ms, pick: [mute]}"]
    checked = invoke("check", "paper", *changes, "--set", "duration=500 ms").stdout.splitlines()
    faults = [line for line in checked if line.startswith("fault from ")]
    shown = invoke("run", "paper", *QUICK, *changes, "--out", tmp_path).stderr.splitlines()
    assert len(faults) == 24
    assert [line for line in shown if line.startswith(("fault ", "... "))] == [*faults[:20], "... and 4 more faults"]
    assert invoke("run", "paper", *QUICK, *changes, "--out", tmp_path, "-q").stderr == ""
