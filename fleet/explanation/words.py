"""An explanation in words: short lines, each with one fact of the log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from fleet.explanation.evidence import CAUSES, Gap, Heard, VehicleThen
from fleet.explanation.why import Why

_MOST_FAULTS, _MOST_GAPS, _MOST_VEHICLES, _MOST_LINKS, _MOST_HEARD = 8, 8, 12, 6, 6


def lines(why: Why) -> list[str]:
    """All of it."""
    return [*_verdict(why), "", *_faults(why), "", *_messages(why), "", *_vehicles(why), "",
            "the point of no return", f"  {why.no_return.words}", *_after(why)]  # fmt: skip


def _verdict(why: Why) -> Iterator[str]:
    yield f"{why.scenario}, seed {why.seed}: {why.check} failed"
    yield f"  asked  {why.asked}"
    yield f"  found  {why.found}"
    if why.held_until_s < why.failed_s:
        yield f"  it held until {why.held_until_s:g} s, and had failed by {why.failed_s:g} s"
    else:
        yield f"  it failed at {why.failed_s:g} s"
    if why.others:
        yield f"  also failed: {', '.join(why.others)} (--check explains another one)"


def _faults(why: Why) -> Iterator[str]:
    if not why.faults:
        yield f"no fault had begun by {why.at_s:g} s"
        return
    yield "faults"
    shown = sorted(why.faults, key=lambda fault: (not fault.on, -fault.from_s))[:_MOST_FAULTS]
    for fault in sorted(shown, key=lambda fault: fault.from_s):
        span = f"since {fault.from_s:g} s" if fault.on else f"{fault.from_s:g} to {fault.to_s:g} s"
        yield f"  {'on   ' if fault.on else 'over '}  {span}: {fault.what} ({fault.id})"
    if len(why.faults) > len(shown):
        yield f"  and {len(why.faults) - len(shown)} more, which were over"


def _messages(why: Why) -> Iterator[str]:
    lost = sum(why.lost.values())
    if not lost:
        yield f"all {why.sent} messages arrived" if why.sent else "no message was sent"
        return
    yield f"messages that had not arrived by {why.at_s:g} s: {lost} of {why.sent}"
    for cause, count in why.lost.items():
        yield f"  {count}  {cause}: {CAUSES.get(cause, cause)}"
    yield "  the longest silences"
    for gap in why.gaps[:_MOST_GAPS]:
        yield f"    {_gap(gap)}"


def _gap(gap: Gap) -> str:
    span = f"at {gap.from_s:g} s" if gap.from_s == gap.to_s else f"from {gap.from_s:g} to {gap.to_s:g} s"
    each = f"{gap.messages} message{'s' if gap.messages > 1 else ''}"
    on = ", and it went on" if gap.goes_on else ""
    return f"{_some(gap.links, _MOST_LINKS)} {span}: {each}, {gap.words}{on}"


def _vehicles(why: Why) -> Iterator[str]:
    yield f"what each vehicle knew at {why.at_s:g} s"
    for vehicle in why.vehicles[:_MOST_VEHICLES]:
        yield from _vehicle(vehicle)
    if len(why.vehicles) > _MOST_VEHICLES:
        yield f"  and {len(why.vehicles) - _MOST_VEHICLES} more vehicles (--json has them)"


def _vehicle(then: VehicleThen) -> Iterator[str]:
    begin = f"  vehicle {then.vehicle}"
    if then.silent_s is not None:
        yield f"{begin}: had reported nothing for {then.silent_s:.3g} s"
        return
    if then.signals:
        yield f"{begin}: " + ", ".join(f"{name} {_number(value)}" for name, value in then.signals.items())
    else:
        yield f"{begin}:"
    if then.off_m is not None:
        sure = "" if then.sd_m is None else f", and took {then.sd_m:.2g} m for its error"
        yield f"    it was {then.off_m:.2g} m from where it believed to be{sure}"
    if then.heard:
        worst = sorted(then.heard, key=lambda one: (one.age_s is not None, -(one.age_s or 0.0)))
        yield f"    it had: {_some([_heard(one) for one in worst], _MOST_HEARD, '; ')}"


def _heard(heard: Heard) -> str:
    if heard.sent_s is None:
        return f"nothing of {heard.vehicle}"
    moved = "" if heard.moved_m is None else f" and {heard.moved_m:.2g} m away"
    return f"of {heard.vehicle} news from {heard.sent_s:g} s, {heard.age_s:.3g} s old{moved}"


def _after(why: Why) -> Iterator[str]:
    for note in why.notes:
        yield f"  note: {note}"


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:.4g}"


def _some(texts: Sequence[str], most: int, between: str = ", ") -> str:
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return between.join(texts[:most]) + more
