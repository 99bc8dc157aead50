"""A log with an external agent is verified with what that agent said; nothing goes on from where it stood.

The logs are of our own agents, marked external and run in this process, so that there is no doubt about what an agent
would have said; `tests/addons/hosts/protocol/test_conformance.py` verifies one of a stranger.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from failing_laws import module as module
from in_process_runs import recorded
from plain_messages import encoded
from talking import talking
from tool import invoke

import fleet.execution.execute
import fleet.execution.in_process
from agents.config import AgentConfig
from agents.make_agent import make_agent
from fleet.execution.options import Options
from fleet.logs.schemas import Doubles, MessageField
from fleet.repeat.recorded_agent import NotRecordedError
from fleet.repeat.verify import verification_lines, verify
from fleet.result.result import Status

EXTERNAL = "per_vehicle={3: {external: true}}"
LINKS = "'*': 'delay 200ms 50ms loss 20% duplicate 10% corrupt 20%', '3->4': 'corrupt 100%', '3->2': 'down'"
ROUGH = f"network.links={{{LINKS}}}"
FAULTS = "faults=[{at: 300 ms, for: 400 ms, kill: 3}, {at: 900 ms, slow: {vehicles: 3, by: 3 ticks}, for: 500 ms}]"
CASES = {
    "rough": ("paper", ["duration=2.5 s", ROUGH]),
    "faults": ("rough-sea", ["duration=2 s", FAULTS]),
    "snapshots": ("paper", ["duration=2 s"]),
    "thinned": ("paper", ["duration=2 s", "log={every: 10 ticks, command: 1 tick, control: 20 ticks}"]),
    "acoustic": ("acoustic-s2c", ["duration=3 s", "log.command=1 tick"]),
}


@pytest.fixture
def log(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The log of a case, in this process as if somebody had joined; from then on there is no agent 3 of ours."""
    name, overrides = CASES[request.param]
    with monkeypatch.context() as patch:
        patch.setattr(fleet.execution.execute, "refuse", lambda *_: None)
        result = recorded(tmp_path, name, "checks={}", EXTERNAL, *overrides)
    assert result.status is Status.PASS, result.reason

    def others(config: AgentConfig) -> object:
        assert config.id != 3
        return make_agent(config)

    monkeypatch.setattr(fleet.execution.in_process, "make_agent", others)
    return result.directory / "run.mcap"


@pytest.mark.parametrize("log", CASES, indirect=True)
def test_what_it_said_gives_the_same_log(log: Path) -> None:
    """Commands, telemetry, memories and payloads, lost and damaged ones included: every message, bit for bit."""
    found = verify(log)
    said = verification_lines(found)
    assert found.reproduced, said
    assert found.until_s == found.end_s
    assert said[0] == "vehicle 3 is external: its commands and payloads were taken from the log"
    assert said[1].startswith("reproduced bit for bit")


@pytest.mark.parametrize("log", ["rough"], indirect=True)
@pytest.mark.parametrize("share", [0.45, 0.7, 0.93])
def test_a_cut_log_is_verified_as_far_as_it_tells(log: Path, share: float) -> None:
    """What was under way when it ended is nobody's mistake: at most a delay's worth less is compared."""
    data = log.read_bytes()
    log.write_bytes(data[: int(share * len(data))])
    found = verify(log)
    assert found.reproduced, verification_lines(found)
    assert found.messages > 0
    assert "reproduced bit for bit" in verification_lines(found)[1]


@pytest.mark.parametrize("log", ["snapshots"], indirect=True)
def test_nothing_goes_on_from_it_and_whatif_says_whose_it_is(log: Path) -> None:
    refused = invoke("run", "--from", log, "--quiet")
    assert refused.exit_code == 2
    assert "vehicle 3 is external in" in refused.output
    asked = invoke("whatif", log, "--agent", 3)
    assert asked.exit_code == 0, asked.output
    assert "note  vehicle 3 is external: what was recorded is what somebody else's agent commanded" in asked.output
    assert "identical" in asked.output


def test_what_it_said_in_lines_is_repeated(
    module: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = talking(module, EXTERNAL, floods=300, ends_at=99)
    with monkeypatch.context() as patch:
        patch.setattr(fleet.execution.execute, "refuse", lambda *_: None)
        result = fleet.execution.execute.execute(scenario, Options(tmp_path, in_process=True, quiet=True))
    assert result.status is Status.PASS, result.reason
    made: list[int] = []
    make = fleet.execution.in_process.make_agent
    monkeypatch.setattr(fleet.execution.in_process, "make_agent", lambda config: made.append(config.id) or make(config))
    found = verify(result.directory / "run.mcap")
    assert found.reproduced, verification_lines(found)
    assert made == [1, 2]


def test_thinned_commands_cannot_be_said_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet.execution.execute, "refuse", lambda *_: None)
    result = recorded(tmp_path, "paper", "duration=1 s", "checks={}", EXTERNAL, "log.every=10 ticks")
    with pytest.raises(NotRecordedError, match=r"has every 10th command only: .*\(log\.command: 1 tick\)$"):
        verify(result.directory)


def test_doubles_are_decoded_to_the_same_bits() -> None:
    columns = [MessageField("a", "", ""), MessageField("b", "", "", 3), MessageField("c", "", "", 40)]
    values = tuple((-1.0) ** k * 0.1 * k for k in range(44))
    data = encoded(columns, values)
    assert Doubles(columns).decode(data) == values
    assert str(Doubles(columns).decode(data)[1]) == str(values[1])
