"""What agents say is in the log: all of it, in order, with the same bytes however the run is made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from failing_laws import module as module
from first_difference import assert_same_bytes
from in_process_runs import log_of
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from talking import talking

import fleet
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.repeat.verify import verify
from fleet.result.result import Result, Status
from fleet.scenario.loading import with_overrides
from fleet.scenario.scenario import Scenario

KILL = "faults=[{kill: 3, at: 530 ms}]"
CASES = {
    "plain": ([], {}),
    "thinned": (["log.every=7 ticks", "log.scene=0 ticks", "log.transforms=0 ticks", KILL], {"ends_at": 99}),
    "flood": (["log.every=5 ticks"], {"floods": 4_000, "fails_at": 4}),
}


def run(scenario: Scenario, folder: Path, *, in_process: bool = True) -> Result:
    return execute(scenario, Options(folder, in_process=in_process, quiet=True))


def said(result: Result) -> list[tuple[int, int, str, str]]:
    """(time [ns], vehicle, stream, text) of every line, as the log has them in their order."""
    log = fleet.open_log(log_of(result))
    found = []
    for i in (1, 2, 3):
        topic = log[f"said/{i}"]
        if len(topic):
            rows = zip(topic.publish_ns.tolist(), topic["file"], topic["message"], strict=True)
            found += [(at_ns, i, stream, text) for at_ns, stream, text in rows]
    return found


@pytest.mark.parametrize("case", CASES)
def test_bytes_are_the_same(case: str, module: Callable[[str], str], tmp_path: Path) -> None:
    changes, parameters = CASES[case]
    scenario = talking(module, *changes, **parameters)
    alone = run(scenario, tmp_path / "alone")
    each = run(scenario, tmp_path / "each", in_process=False)
    shared = run(with_overrides(scenario, ["agents.per_process=2"]), tmp_path / "shared", in_process=False)
    assert_same_bytes(log_of(alone), log_of(each))
    for other in (each, shared):
        assert other.digest == alone.digest
        assert [one.found for one in other.checks] == [one.found for one in alone.checks]
    assert verify(log_of(alone)).difference is None


def test_no_line_is_lost_between_frames(module: Callable[[str], str], tmp_path: Path) -> None:
    """Frames come every 7 ticks; agent 3 is killed between two of them, and the others end with the last tick."""
    changes, parameters = CASES["thinned"]
    result = run(talking(module, *changes, **parameters), tmp_path)
    assert result.status is Status.PASS, result.checks
    expected = []
    for i in (1, 2, 3):
        for tick in range(100 if i < 3 else 53):
            at_ns = tick * 10_000_000 + i
            if tick % 7 == i:
                expected += [(at_ns, i, "out", f"tick {tick}"), (at_ns, i, "err", "caf? \x1b[31m")]
            if tick == 99:
                expected.append((at_ns, i, "end", "exit status 0"))
    assert said(result) == expected


def test_a_flood_is_bounded(module: Callable[[str], str], tmp_path: Path) -> None:
    """How its program ended comes at once, and the newest lines before it."""
    changes, parameters = CASES["flood"]
    result = run(talking(module, *changes, **parameters), tmp_path)
    lines = said(result)
    assert Counter(i for _, i, _, _ in lines)[2] <= 2 + 2 * 200
    two = [(stream, text) for _, i, stream, text in lines if i == 2]
    assert two[-3:] == [("out", "flood 3999"), ("err", "ValueError: planned"), ("failed", "exit status 1")]
    assert sum("left out" in text for _, text in two) == 2
    assert [verdict.found for verdict in result.checks if verdict.failed] == [
        "vehicle 2: at 0.04 s: exit status 1: ValueError: planned"
    ]


def test_other_readers_show_the_lines(module: Callable[[str], str], tmp_path: Path) -> None:
    result = run(talking(module, ends_at=50, fails_at=90), tmp_path)
    with log_of(result).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [(schema.name, channel.topic, message) for schema, channel, _, message in reader.iter_decoded_messages()
                 if channel.topic.startswith("said/")]  # fmt: skip
    assert {(schema, topic) for schema, topic, _ in found} == {("foxglove.Log", f"said/{i}") for i in (1, 2, 3)}
    names = {1: "DEBUG", 2: "INFO", 3: "WARNING", 4: "ERROR"}
    assert {(message.file, names[message.level]) for _, _, message in found} == {
        ("out", "INFO"), ("err", "WARNING"), ("end", "INFO"),
    }  # fmt: skip
    first = found[0][2]
    assert (first.name, first.message, first.timestamp.nanos) == ("vehicle 1", "tick 1", 10_000_001)
