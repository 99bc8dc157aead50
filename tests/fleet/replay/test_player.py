"""The timing of a replay, on a clock that is told: no zenoh, no terminal, no waiting."""

from __future__ import annotations

from bisect import bisect_left

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.replay.player import LATE_NS, MeasuredRate, Player
from fleet.terminal.keyboard import Key, decode

S = 1_000_000_000
ALL = 10**9

times_ = st.lists(st.integers(0, 10 * S), min_size=1, max_size=40).map(sorted)
rates_ = st.sampled_from([0.1, 0.5, 1.0, 1.1, 2.0, 7.3, 100.0])


def player_of(times: list[int], rate: float = 1.0, **more: bool) -> Player:
    return Player(times, times[0], times[-1], rate=rate, **more)


def play_through(player: Player, now: int = 0) -> list[tuple[int, int]]:
    """(wall time, index) of everything, for a caller who comes exactly when told to."""
    found: list[tuple[int, int]] = []
    while not player.over:
        found += [(now, index) for index in player.due(now, ALL)]
        now += player.wait_ns(now) or 0
    return found


@given(times_, rates_)
def test_everything_once_in_order_and_when_due(times: list[int], rate: float) -> None:
    """Never early, and at most a rounding late, for whoever sleeps as long as `wait_ns` says."""
    found = play_through(player_of(times, rate))
    assert [index for _, index in found] == list(range(len(times)))
    for wall, index in found:
        due = (times[index] - times[0]) / rate
        # A double has 53 bits: a wall time of 1e11 ns is exact to far less than 1 ns, its product with a rate to 1.
        assert -1 <= wall - due <= 2 + 2 / rate


@given(times_, rates_, st.lists(st.integers(0, 3 * S), max_size=60))
def test_careless_callers_lose_nothing(times: list[int], rate: float, naps: list[int]) -> None:
    """Whenever one comes, all that has become due is handed out, once and in order, and nothing else."""
    player, now, found = player_of(times, rate), 0, []
    for nap in [*naps, 2000 * S]:
        now += nap
        found += list(player.due(now, ALL))
        elapsed = int(now * rate)
        assert len(found) == sum(t - times[0] <= elapsed for t in times)
    assert player.over and found == list(range(len(times)))


@given(times_, rates_)
def test_missed_deadlines_are_those_that_came_too_late(times: list[int], rate: float) -> None:
    player = player_of(times, rate)
    now = 2 * S
    due = list(player.due(now, ALL))
    late = [index for index in due if (times[index] - times[0]) / rate < now - LATE_NS]
    assert abs(player.missed - len(late)) <= sum(
        abs((times[index] - times[0]) / rate - (now - LATE_NS)) <= 2 / rate + 2 for index in due
    )


def test_on_time_is_not_missed() -> None:
    player = player_of([0, S, 2 * S])
    play_through(player)
    assert player.missed == 0


@given(times_, st.integers(1, 7))
def test_as_fast_as_possible(times: list[int], most: int) -> None:
    """Rate 0 hands out everything without time passing, in portions."""
    player, found = player_of(times, 0.0), []
    while not player.over:
        assert player.wait_ns(0) == 0
        portion = list(player.due(0, most))
        assert 0 < len(portion) <= most
        found += portion
        assert player.position(0) == times[portion[-1]]
    assert found == list(range(len(times))) and player.missed == 0


acts_ = st.lists(
    st.tuples(
        st.sampled_from(["wait", "toggle", "step", "forward", "back", "faster", "slower", "due"]),
        st.integers(0, 3 * S),
    ),
    max_size=40,
)


@given(times_, rates_, acts_, st.booleans())
def test_invariants_whatever_is_pressed(times: list[int], rate: float, acts: list[tuple[str, int]], loop: bool) -> None:
    """The position stays within the log; a pause holds it, also over a seek; what is handed out next is the first
    message at or after a position sought; without seeks and laps nothing comes twice or is left out."""
    player, now, handed = player_of(times, rate, loop=loop), 0, list[int]()
    expected = 0  # index
    for act, number in acts:
        paused, before = player.paused, player.position(now)
        found: range = range(0)
        match act:
            case "wait":
                now += number
            case "toggle":
                player.toggle(now)
                assert player.paused is not paused
            case "step":
                found = player.step(now)
                assert player.paused
            case "forward" | "back":
                target = before + (number if act == "forward" else -number)
                player.seek(now, target)
                assert player.paused is paused
                at = min(max(target, times[0]), times[-1])
                expected = bisect_left(times, at)
                assert player.position(now) in (at, times[expected])
            case "faster" | "slower":
                player.set_rate(now, player.rate * (1.1 if act == "faster" else 1 / 1.1))
            case "due":
                found = player.due(now, ALL)
                assert not (paused and found)
        if found:
            assert found.start == (expected if expected < len(times) else 0)
            expected = found.stop
            handed += found
        assert times[0] <= player.position(now) <= times[-1]
        if paused and player.paused and act in ("wait", "due", "faster", "slower"):
            assert player.position(now) == before
            assert player.wait_ns(now) is None
    if not loop and not any(act in ("forward", "back") for act, _ in acts):
        assert handed == list(range(len(handed)))


@given(times_, rates_, st.integers(0, 10 * S), st.integers(0, 100 * S))
def test_a_pause_shifts_the_rest(times: list[int], rate: float, at: int, pause: int) -> None:
    """Whoever pauses and resumes hears the rest as if the pause had not been."""
    plain = dict(reversed([(index, wall) for wall, index in play_through(player_of(times, rate))]))
    player = player_of(times, rate)
    first = [(at, index) for index in player.due(at, ALL)]
    player.pause(at)
    assert not player.due(at + pause, ALL)
    player.resume(at + pause)
    for wall, index in play_through(player, at + pause):
        assert abs(wall - pause - max(plain[index], at)) <= 4 + 4 / rate
    assert len(first) == sum((t - times[0]) <= int(at * rate) for t in times)


def test_step_takes_a_tick() -> None:
    player = player_of([0, 0, 5, 5, 5, 9], paused=True)
    assert [list(player.step(0)) for _ in range(4)] == [[0, 1], [2, 3, 4], [5], []]
    assert player.over and player.position(0) == 9


def test_loop_begins_again() -> None:
    player = player_of([0, S], loop=True)
    heard, now = list[int](), 0
    while player.laps < 3:
        heard += player.due(now, ALL)
        wait = player.wait_ns(now)
        assert wait is not None and not player.over
        now += wait
    assert heard == [0, 1, 0, 1, 0, 1, 0]


def test_loop_lasts_as_long_as_was_asked_for() -> None:
    """A part that ends behind its last message is played to its end before it begins again."""
    player = Player([0, S], 0, 4 * S, loop=True)
    walls = []
    now = 0
    while len(walls) < 5:
        walls += [now for _ in player.due(now, ALL)]
        now += player.wait_ns(now) or 0
    assert [round(wall / S) for wall in walls] == [0, 1, 4, 5, 8]


def test_only_the_part_that_was_asked_for() -> None:
    times = [0, 1, 2, 3, 3, 4, 5]
    assert [index for _, index in play_through(Player(times, 2, 3))] == [2, 3, 4]
    assert Player(times, 9, 9).over


def test_a_slow_publisher_holds_the_position() -> None:
    """The position is that of what is played, not of what should have been."""
    player = player_of([0, S, 2 * S, 9 * S])
    assert list(player.due(3 * S, 1)) == [0]
    assert player.position(3 * S) == S
    player.pause(3 * S)
    player.resume(3 * S)
    assert list(player.due(3 * S, ALL)) == [1]


@given(st.integers(0, 10 * S), st.integers(0, 100 * S))
def test_an_absence_changes_nothing_but_the_time(at: int, away: int) -> None:
    """Whoever was suspended goes on where it was: the same messages, as much later, none of them late."""
    times = [n * S // 4 for n in range(40)]
    stayed, left = Player(times, 0, times[-1]), Player(times, 0, times[-1])
    left.stood_still(away)
    assert left.position(at + away) == stayed.position(at)
    assert left.due(at + away, 100) == stayed.due(at, 100)
    assert (left.missed, left.wait_ns(at + away)) == (stayed.missed, stayed.wait_ns(at))


def test_pace() -> None:
    pace = MeasuredRate()
    values = [pace.update(now, 2 * now) for now in range(0, 5 * S, S // 10)]
    assert values[0] == 0 and values[-1] == 2
    assert pace.update(6 * S, 0) == 2  # a seek back is no pace
    pace.restart()
    assert pace.update(7 * S, 50 * S) == 2  # nor one forward, if it is told
    assert pace.update(8 * S, 53 * S) == 3


@pytest.mark.parametrize(
    ("typed", "keys"),
    [
        (b" ", [Key.PAUSE]),
        (b"\x1b[C\x1bOC", [Key.STEP, Key.STEP]),
        (b"\x1b[A\x1b[B", [Key.FASTER, Key.SLOWER]),
        (b"\x1b[1;2C]\x1b[1;2D[", [Key.FORWARD, Key.FORWARD, Key.BACK, Key.BACK]),
        (b"x\x1bq\x1b[5~\x1b[1;5C ", [Key.PAUSE]),
    ],
)
def test_keys(typed: bytes, keys: list[Key]) -> None:
    assert decode(typed) == (keys, b"")


@given(st.lists(st.sampled_from([b" ", b"\x1b[C", b"\x1b[1;2D", b"]", b"\x1b[5~"])), st.data())
def test_keys_may_come_in_pieces(presses: list[bytes], data: st.DataObject) -> None:
    """A terminal behind a slow line sends a sequence in several reads."""
    typed = b"".join(presses)
    cut = data.draw(st.integers(0, len(typed)))
    first, rest = decode(typed[:cut])
    second, left = decode(rest + typed[cut:])
    assert (first + second, left) == (decode(typed)[0], b"")


@given(st.binary(max_size=60))
def test_no_typing_breaks_it(typed: bytes) -> None:
    _, rest = decode(typed)
    assert len(rest) < 16
