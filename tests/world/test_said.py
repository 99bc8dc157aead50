"""What an agent says with its commands leaves with the next frame, whatever becomes of the commands."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from failing_laws import module as module
from msgspec import structs
from talking import talking

from netem.wire.codec import encode
from netem.wire.messages import Command, Frame, Frames, Said, SaidBy, VehicleFrame
from netem.wire.parts import PART_BYTES
from world.frames import FrameAssembly
from world.lockstep import Lockstep, NavTo
from world.process import _said_bytes
from world.realtime import RealtimeRun


def line(k: int) -> Said:
    return Said(k, "out", str(k))


def row(i: int) -> VehicleFrame:
    return VehicleFrame(i, (0.0,) * 5, (0.0,) * 5, (), (), b"", (), (), (), ())


def test_lines_wait_for_the_next_frame_and_the_last_for_the_end() -> None:
    frames = FrameAssembly(2, 10, 4)
    for k, (tick, i) in enumerate([(0, 2), (0, 1), (3, 2), (1, 1), (9, 1)]):
        frames.say(tick, i, [line(k)])
    found = []
    for tick in (0, 4, 8, 10):
        frames.row(tick, row(1))
        frames.row(tick, row(2))
        found += frames.complete()
    assert [[(one.vehicle, one.said.text) for one in frame.said] for frame in found] == [
        [(1, "1"), (2, "0")], [(1, "3"), (2, "2")], [], [(1, "4")],
    ]  # fmt: skip


def test_a_frame_that_has_left_takes_nothing_more() -> None:
    """On a wall clock an agent may answer when its tick is over."""
    frames = FrameAssembly(1, 10, 1)
    frames.row(0, row(1))
    assert len(frames.complete()) == 1
    frames.say(0, 1, [line(1)])
    frames.row(1, row(1))
    (frame,) = frames.complete()
    assert frame.said == (SaidBy(1, line(1)),)


@pytest.mark.parametrize("length", [0, 1_000])
def test_a_line_is_no_longer_than_is_reckoned(length: int) -> None:
    """Or a part of a frame would not fit into a message."""
    said = SaidBy(3_000, Said(2**62, "failed", "𝄞" * length))
    frame = Frame(1, True, (), (), (), (said,))
    assert len(encode(Frames((frame,)))) <= _said_bytes(said) + 20 <= PART_BYTES


def test_a_late_command_is_heard(module: Callable[[str], str]) -> None:
    """In time, late or stale: it does not act any more, but what it says was said."""
    run = RealtimeRun(talking(module).world_config)
    run.grant(10)
    for _ in range(3):
        run.begin()
        run.finish()
    for tick in (2, 1):  # the second is stale
        run.command(1, Command(0, tick, (0.0, 0.0, 0.0), (), (line(tick),)))
    run.begin()
    (frame,) = run.finish()
    assert [one.said.text for one in frame.said] == ["2", "1"]


def test_a_frame_has_the_command_without_what_was_said(module: Callable[[str], str]) -> None:
    """It would be in the frame twice."""
    world = Lockstep(talking(module).world_config)
    navs = [out for out in world.grant(1) if isinstance(out, NavTo)]
    plain = Command(0, 0, (1.0, 0.0, 0.0), ())
    frames = []
    for out in navs:
        said = structs.replace(plain, said=(line(out.id),))
        frames += [one for one in world.command(out.id, said, encode(said)) if isinstance(one, Frame)]
    (frame,) = frames
    assert {one.command for one in frame.vehicles} == {encode(plain)}
    assert [one.said.text for one in frame.said] == ["1", "2", "3"]
