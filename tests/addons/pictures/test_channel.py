"""The timeline of a channel: what a log says of transmissions is what the channel did."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from channel_starts import channel_starts
from in_process_runs import recorded
from shared import made_once

from fleet.addons.pictures.channel import OVERHEARD, SENDS, DrawnTransmission, _moment, lanes, timeline, transmissions
from fleet.addons.pictures.runs import LoggedRun, NothingToDraw, View, load
from netem.cause import Cause

PARTITION = "faults=[{at: 8 s, for: 6 s, partition: '1,2 / 3,4'}]"
LOSSY = "network.links={'*': loss 20%}"


Ran = Callable[..., tuple[LoggedRun, set[tuple[int, int]]]]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """Gives a run with (modem, first tick) of each of its transmissions; all workers share those with equal changes."""

    def make(folder: Path, changes: tuple[str, ...]) -> tuple[Path, set[tuple[int, int]]]:
        with channel_starts() as found:
            directory = recorded(folder, "acoustic-s2c", "duration=20 s", "checks={}", *changes).directory
        return directory, set(found)

    def run(*changes: str) -> tuple[LoggedRun, set[tuple[int, int]]]:
        directory, found = made_once(tmp_path_factory, ("channel", changes), lambda folder: make(folder, changes))
        return load([directory])[0], found

    return run


@pytest.mark.parametrize("changes", [(), (PARTITION, LOSSY), ("network.acoustic={modem: s2c, mac: csma}",)])
def test_every_transmission_is_where_it_was(ran: Ran, changes: tuple[str, ...]) -> None:
    run, begun = ran(*changes)
    found = transmissions(run, run.log.links)
    at = {(one.src, round(one.begin / run.tick_s)) for one in found}
    # What is in flight at the end is left out, since the log does not say whether it had begun.
    last = {src: max(tick for i, tick in begun if i == src) for src, _ in begun}
    assert at <= begun and begun - at <= set(last.items()) and len(at) > 20
    for one in found:
        for dst, when, _ in one.heard:
            assert when > one.begin and dst != one.src


def test_what_is_lost_is_there_where_it_would_have_been_heard(ran: Ran) -> None:
    """A reception is spoiled where another is on the air at the receiver, which the picture has to show."""
    run, _ = ran()
    found = transmissions(run, run.log.links)
    spoiled = [(dst, at, one) for one in found for dst, at, fate in one.heard if fate == Cause.COLLISION]
    assert spoiled
    for dst, at, one in spoiled:
        others = [t for other in found if other is not one for i, t, _ in other.heard if i == dst]
        assert any(abs(t - at) < one.airtime + run.tick_s for t in others)
    duplex = [(dst, at, one) for one in found for dst, at, fate in one.heard if fate == Cause.HALF_DUPLEX]
    assert duplex
    for dst, at, one in duplex:
        assert any(o.src == dst and abs(o.begin - at) < one.airtime + run.tick_s for o in found)


def test_a_row_for_each_modem(ran: Ran) -> None:
    run, _ = ran()
    (ax,) = timeline([run], View()).axes
    assert [text.get_text() for text in ax.get_yticklabels()] == ["UUV 1", "UUV 2", "UUV 3", "UUV 4"]
    drawn = {str(one.get_gid()).removeprefix("channel-"): one for one in ax.collections}
    assert {SENDS, Cause.DELIVERED, OVERHEARD} <= drawn.keys()
    (ax,) = timeline([run], View((1, 2), None, (5.0, 9.0))).axes
    assert ax.get_xlim() == (5.0, 9.0) and len(ax.get_yticklabels()) == 2


def test_no_water_no_timeline(tmp_path: Path) -> None:
    run = load([recorded(tmp_path, "paper", "duration=1 s", "checks={}").directory])[0]
    with pytest.raises(NothingToDraw, match="not acoustic"):
        timeline([run], View())


def test_spans_that_overlap_have_lanes_of_their_own() -> None:
    assert lanes([(0.0, 2.0), (1.0, 3.0), (2.0, 4.0), (2.5, 5.0), (3.0, 6.0)]) == [0, 1, 0, 2, 1]


def test_the_window_leaves_out_what_is_empty() -> None:
    """Three transmissions in ten minutes: before, the picture began at 0."""
    on_air = [DrawnTransmission(1, begin, 0.5, ((2, begin + 0.3, "delivered"),)) for begin in (300.0, 310.0, 320.0)]
    begin, end = _moment(on_air, 600.0)
    assert 280.0 < begin < 300.0 and 320.8 < end < 340.0
