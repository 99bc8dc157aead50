"""A number ends with its program: what logs and explanations know of programs that were killed or have ended."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from known_programs import BEGIN_NS, Known

from fleet.addons.robots.relay_run import RelayRun
from fleet.addons.studies.explanation.evidence import Evidence, evidence
from fleet.logs.open_log import Log, open_log
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile
from fleet.recorder.writer import LogWriter
from netem.wire.messages import LinkReport

SECTIONS: dict[str, Any] = {
    "nodes": {"auv.1": {}, "m2": {}, "m3": {}}, "duration": "2 s",
    "signals": {"x": {"line": "(?P<value>.*)", "unit": "m"}},
    "programs": {"*": {"run": "a"}}, "faults": [{"at": "500 ms", "for": "500 ms", "kill": "m2"}],
    "checks": {"programs": {"m3": "done"}},
}  # fmt: skip


class Recorded(Known):
    """What programs are said to do goes into a log, as in a run."""

    def __init__(self, folder: Path, **sections: Any) -> None:
        super().__init__(folder, **sections)
        scenario = self._scenario
        self.runs(*self.states)
        self.log = LogFile(folder / "run.mcap")
        self.journal = Journal(scenario, LogWriter(self.log, scenario))
        self.run: Any = SimpleNamespace(
            _programs=self, _scenario=scenario, _begin_ns=BEGIN_NS, _journal=self.journal,
            _places=dict.fromkeys(range(1, scenario.vehicles + 1), (0.0,) * 5),
        )  # fmt: skip

    def at(self, time_s: float, **values: Any) -> None:
        """The keeper says that something happened at a time of the run."""
        self.say(BEGIN_NS + round(time_s * 1e9), **values)

    def ends(self) -> Log:
        ticks = self._scenario.ticks
        self.journal.links(LinkReport(0, False, False, ()))
        for tick in range(0, ticks + 1, 10):
            RelayRun._frame(self.run, tick)
        for until in range(self._scenario.round_ticks, ticks, self._scenario.round_ticks):
            self.journal.links(LinkReport(until, False, False, ()))
        self.journal.links(LinkReport(ticks, True, False, ()))
        self.log.close()
        return open_log(self.log.path)


@pytest.fixture
def recorded(tmp_path: Path) -> Recorded:
    """auv.1 ends by itself at 1.2 s, m2 is killed at 0.5 s and comes back, m3 does its work until 1.4 s."""
    found = Recorded(tmp_path, **SECTIONS)
    for n, name in enumerate(("auv.1", "m2", "m3"), start=1):
        found.at(0.0, told=name, signal=0, value=float(n))
    found.at(0.5, killed="m2")
    found.at(1.0, started="m2", pid=7)
    found.at(1.1, ready="m2")
    found.at(1.1, told="m2", signal=0, value=20.0)
    found.at(1.2, ended="auv.1", code=1, tail=[])
    found.at(1.4, ended="m3", code=0, tail=[])
    return found


def then(recorded: Recorded, log: Log, at_s: float) -> Evidence:
    return evidence(log, at_s, [], protocol=True, nodes=recorded._scenario.nodes)


def test_a_number_ends_with_its_program_unless_it_has_done_its_work(recorded: Recorded) -> None:
    """In the log and where it is looked at afterwards. `why` showed the last one of a program that had been killed."""
    log = recorded.ends()
    spans = [(round(float(topic.t[0]), 2), round(float(topic.t[-1]), 2)) for topic in map(log.__getitem__, topics(log))]
    assert spans == [(0.0, 1.19), (0.0, 2.0), (0.0, 2.0)]
    t = log["uuv/2/control"].t
    assert not [at for at in t if 0.5 <= at < 1.1]
    known = {at: then(recorded, log, at).vehicles for at in (0.4, 0.8, 1.15, 1.8)}
    assert {at: [one.signals.get("control.x") for one in ones] for at, ones in known.items()} == {
        0.4: [1.0, 2.0, 3.0], 0.8: [1.0, None, 3.0], 1.15: [1.0, 20.0, 3.0], 1.8: [None, 20.0, 3.0],
    }  # fmt: skip
    assert {at: [one.silent_s is not None for one in ones] for at, ones in known.items()} == {
        0.4: [False] * 3, 0.8: [False, True, False], 1.15: [False] * 3, 1.8: [True, False, False],
    }  # fmt: skip
    assert [one.life for one in known[1.8]] == [1, 2, 1]


def topics(log: Log) -> list[str]:
    return [f"uuv/{i}/control" for i in log.vehicles]


def test_the_end_of_a_program_is_told_by_the_name_of_its_node(recorded: Recorded) -> None:
    """It was `kill 1 (death-1)`."""
    log = recorded.ends()
    assert [(one.id, one.what, one.begin) for one in log.faults] == [
        ("f1", "kill m2", 0.5), ("death-auv-1", "kill auv.1", 1.2),
    ]  # fmt: skip
    assert then(recorded, log, 1.8).faults[1].on
