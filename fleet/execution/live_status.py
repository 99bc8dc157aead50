"""How the vehicles and the links of a live run are doing: what `fleet status` shows of them.

Nothing of it is kept while the run goes on: it is computed when somebody asks, and for the worst rows only.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Mapping
from math import inf, isfinite
from typing import Any

from msgspec.structs import asdict

from fleet.recorder.journal import Journal
from fleet.recorder.metrics import SETTLE_M, Series
from fleet.recorder.settling import first_settled, is_long_enough, least_s
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.vehicle_events import vehicle_events

WORST_VEHICLES, WORST_LINKS = 10, 5
MOST_ROWS = 500  # rows of a kind in one answer, also when all are asked for


def vehicle_rows(
    scenario: Scenario, journal: Journal, dead: Collection[int], *, every: bool = False
) -> list[dict[str, Any]]:
    """A row for each vehicle; of many, those with the greatest formation errors. In the order of their numbers."""
    series = journal.metrics.series
    worst = sorted((i for i in series if series[i].formation), key=lambda i: -badness(series[i].formation[-1]))
    ages = _oldest(scenario, journal)
    return [
        {
            "vehicle": i,
            "state": _state(i, journal, dead),
            "formation_m": series[i].formation[-1],
            "e_m": series[i].e[-1],
            "settled": _is_settled(scenario, journal, series[i]),
            "oldest_s": ages[i][0] * scenario.tick_ns / 1e9 if i in ages else None,
            "oldest_of": ages[i][1] if i in ages else None,
        }
        for i in sorted(worst[: MOST_ROWS if every else WORST_VEHICLES])
    ]


def link_rows(scenario: Scenario, journal: Journal, *, every: bool = False) -> list[dict[str, Any]]:
    """A row for each link, the worst ones first: what was heard last is oldest, then the greatest share is lost."""
    rows: list[dict[str, Any]] = []
    now = max(0, journal.written)
    for (src, dst), account in journal.ledger.accounts.items():
        lost = sum(account.lost.values()) - account.replaced
        settled = account.delivered + lost
        age_s = (now - journal.ages.links[src, dst].heard) * scenario.tick_ns / 1e9
        share = lost / settled if settled else 0.0
        counts = {"delivered": account.delivered, "lost": lost, "lost_share": share}
        name = scenario.link_name((src, dst))
        rows.append({"link": name, "src": src, "dst": dst, **counts, "age_s": age_s})
    rows.sort(key=lambda row: (-row["age_s"], -row["lost_share"], row["src"], row["dst"]))
    return rows[: MOST_ROWS if every else WORST_LINKS]


def event_rows(scenario: Scenario, journal: Journal) -> list[dict[str, Any]]:
    """The events of vehicles: a row for each vehicle and kind, in the order of their first occurrence."""
    events = [event for event in journal.happened if not event.is_fault]
    begun = [event for event in events if event.action == "begins"]
    ended = {event.fault for event in events if event.action == "ends"}
    last = {event.what: event for event in begun}
    return [
        {
            **asdict(row),
            "id": last[row.what].fault,
            "entry": last[row.what].entry,
            "last_s": last[row.what].tick * scenario.tick_ns / 1e9,
            "lasts": last[row.what].fault not in ended,
        }
        for row in vehicle_events((event.what, event.tick * scenario.tick_ns / 1e9) for event in begun)
    ]


def badness(error_m: float | None) -> float:
    """By what errors are put in order: what is no number is worst."""
    return error_m if error_m is not None and isfinite(error_m) else inf


def _state(i: int, journal: Journal, dead: Collection[int]) -> str:
    if i in journal.diverged:
        return "diverged"
    words = ["tumbled"] * (i in journal.tumbled) + ["no agent"] * (i in dead)
    return ", ".join(words) or "alive"


def _is_settled(scenario: Scenario, journal: Journal, series: Series) -> bool:
    """Whether the consensus error has been below 5 cm for as long as the result table asks for, up to now."""
    times = journal.metrics.times
    least = least_s(scenario.disturbance, times[-1] - times[0])
    begin = max(0, bisect_left(times, times[-1] - least) - 1)  # only so much is looked at, however long the run is
    first = first_settled(series.e, SETTLE_M, begin, len(times))
    return first < len(times) and is_long_enough(times, first, len(times), least)


def _oldest(scenario: Scenario, journal: Journal) -> Mapping[int, tuple[int, int]]:
    """By vehicle: the greatest age [ticks] of its last message from a neighbour, and the number of that neighbour."""
    now = max(0, journal.written)
    found: dict[int, tuple[int, int]] = {}
    for (src, dst), age in journal.ages.links.items():
        found[dst] = max(found.get(dst, (-1, 0)), (now - age.heard, src))
    return found
