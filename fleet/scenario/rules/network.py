"""Rules on links and on the acoustic channel."""

from __future__ import annotations

from collections.abc import Iterator

from fleet.quantities import show_time, vehicle_numbers
from fleet.scenario.parts import Parts
from fleet.scenario.rules.report import Report, known_links, vehicles_exist, whole_multiple
from fleet.scenario.schema.network import AcousticSection, LinkSection, LinkStateSection, ModemSection, RangingSection
from fleet.scenario.sections.acoustic import (
    DEFAULT_REQUEST,
    SIZES,
    extent_m,
    guard_ns,
    modem_values,
    speed_of_sound,
    turn_ns,
)
from fleet.scenario.sections.data_files import DataFileError
from fleet.scenario.sections.graph import reached
from fleet.scenario.sections.modem_files import load_site, modem_of, modem_problems
from fleet.scenario.sections.trace_table import TraceTable
from netem.condition import Condition
from netem.errors import TextError
from netem.grammar import print_condition
from netem.link_selector import parse_selector
from netem.modem import Modem
from netem.parsing import nearest

# --- links whose condition changes by itself: states and traces

MOST_STATES = 16
MOST_CHARACTERS = 900_000  # of all traces together as the merged scenario holds them, which has 1,000,000 at most
_FORMS = ("condition", "states", "trace")
_OF_TRACES = ("by", "start", "loop", "offset", "time_scale", "lost_below")

Path = tuple[str, ...]


def link_conditions(parts: Parts, report: Report) -> None:
    """Each entry of links is a condition, or states that lead to each other, or a trace that can be used."""
    characters = 0
    for selector, section in parts.spec.network.links.items():
        path = ("network", "links", selector)
        given = [key for key in _FORMS if getattr(section, key) is not None]
        if len(given) != 1:
            got = " and ".join(given) if given else "none of them"
            report.add(path, f"expected one of condition, states and trace, got {got}")
            continue
        if section.together is not None and not section.states:
            report.add((*path, "together"), "has no effect without states", key=True)
        if section.states is not None:
            _states(report, (*path, "states"), section.states, parts.spec.tick)
        if section.trace is not None:
            characters += _trace(parts, report, path, section)
        else:
            for key in _OF_TRACES:
                if getattr(section, key) is not None:
                    report.add((*path, key), "has no effect without a trace", key=True)
    if characters > MOST_CHARACTERS:
        message = f"the traces of all links take {characters} characters, and {MOST_CHARACTERS} is the most"
        report.add(("network", "links"), message, "fewer rows, or states that fleet fit finds in them", key=True)


def _states(report: Report, path: Path, states: dict[str, LinkStateSection], tick: int) -> None:
    if not 2 <= len(states) <= MOST_STATES:
        report.add(path, f"expected 2 to {MOST_STATES} states, got {len(states)}", "one state is a plain condition")
        return
    for name, state in states.items():
        if state.mean < tick:
            message = f"{show_time(state.mean)} is less than a tick, {show_time(tick)}: nobody could see such a state"
            report.add((*path, name, "mean"), message)
        if state.condition.seed is not None:
            message = "a state has no seed of its own: its draws are the link's"
            report.add((*path, name, "condition"), message)
        for problem, hint in _following(states, name):
            report.add((*path, name, "next"), problem, hint)
    after = {
        name: [other for other in states if state.next is None or state.next.get(other, 0.0) > 0.0]
        for name, state in states.items()
    }
    first = next(iter(states))
    for start, end in [*((first, name) for name in states), *((name, first) for name in states)]:
        if end not in reached([start], after):
            report.add(path, f"{start} never leads to {end}", "every state must lead to every other in the end")
            return


def _following(states: dict[str, LinkStateSection], name: str) -> Iterator[tuple[str, str]]:
    """Mistakes in the next states of a state: a sentence and a hint each."""
    following = states[name].next
    if following is None:
        return
    for other in following:
        if other not in states:
            yield f'there is no state "{other}"', nearest(other, states) or f"there are {', '.join(states)}"
    if name in following:
        yield f"{name} does not follow on itself", "a longer mean keeps the link in it"
    total = sum(following.values())
    if abs(total - 1.0) > 1e-9:
        yield f"expected probabilities that sum up to 100 %, got {100 * total:g} %", ""


def _trace(parts: Parts, report: Report, path: Path, section: LinkSection) -> int:
    """How many characters the trace has in the merged scenario."""
    assert section.trace is not None
    try:
        table = parts.traces(section.trace)
    except DataFileError as error:
        shown = "" if "\n" in section.trace else f"{section.trace}: "
        for problem in error.problems:
            report.add((*path, "trace"), shown + problem)
        return 0
    for key, problem, hint in _misused(section, table):
        report.add((*path, key), problem, hint, key=key != "trace")
    return len(table.text()) + len(table.rows)  # a line break is two characters there


def _misused(section: LinkSection, table: TraceTable) -> Iterator[tuple[str, str, str]]:
    """The options that do not fit each other or the columns: key, sentence, and hint."""
    by_packet = section.by == "packet"
    times = [row.time_ns for row in table.rows if row.time_ns is not None]
    has = "it has " + ", ".join(table.columns)
    if not times and not by_packet:
        yield "trace", f"no such column: time, which a trace by time needs; {has}", "by: packet needs none"
    if section.start is not None:
        if not times:
            yield "start", f"no such column: time, in which it would lie; {has}", ""
        elif not times[0] <= section.start <= times[-1]:
            span = f"{show_time(times[0])} to {show_time(times[-1])}"
            yield "start", f"expected a time in the trace, {span}, got {show_time(section.start)}", ""
    if by_packet and section.time_scale is not None:
        yield "time_scale", "has no effect by packet", ""
    if section.offset is not None and not section.loop:
        yield "offset", "needs loop: true, because what lies before the place would never be used", ""
    if "delivered" in table.columns or "snr" not in table.columns:
        if section.lost_below is not None:
            why = "the trace says what was delivered" if "delivered" in table.columns else f"no such column: snr; {has}"
            yield "lost_below", f"has no effect: {why}", ""
    elif section.lost_below is None:
        yield "trace", "it has snr and no delivered", "lost_below: 10 dB says at which ratio a packet is lost"


def links(parts: Parts, report: Report) -> None:
    written: dict[str, str] = {}
    links = parts.links
    known: set[tuple[int | None, int | None]] = {(None, None), *links}
    known |= {(src, None) for src, _ in links} | {(None, dst) for _, dst in links}
    for text in report.keys("network", "links"):
        path = ("network", "links", text)
        try:
            selector = parse_selector(text)
        except TextError:
            continue  # reported by the schema
        if str(selector) in written:
            report.add(path, f'the same links as "{written[str(selector)]}"', key=True)
        written[str(selector)] = text
        # (None, None), "*", is every link there is, even if that is none: a fleet of one keeps its scenario.
        there = (selector.src, selector.dst) in known
        if not there and not (selector.both and (selector.dst, selector.src) in known):
            report.add(path, "the graph has no such link", known_links(links), key=True)


def radios(parts: Parts, report: Report) -> None:
    """A radio has a rate and a limit, and nothing that a link has; modems are radios of their own."""
    network = parts.spec.network
    for text, radio in network.radios.items():
        path = ("network", "radios", text)
        vehicles_exist(parts.spec, report, path, text, key=True)
        bare = Condition(rate_bit_s=radio.rate_bit_s, rate_overhead=radio.rate_overhead, limit=radio.limit)
        if not radio.rate_bit_s or radio != bare:
            hint = "write 1: rate 80kbit; delay, loss and the rest belong to links"
            report.add(path, f'expected a rate and, if need be, a limit, got "{print_condition(radio)}"', hint)
    if network.radios and network.acoustic is not None:
        report.add(("network", "radios"), "has no effect in water, where modems have a bit_rate", key=True)


def acoustic(parts: Parts, report: Report) -> None:
    """The numbers of the modem and of the water, and the keys that belong to the medium access."""
    spec = parts.spec
    section = spec.network.acoustic
    if section is None:
        return
    at = ("network", "acoustic")
    others = {"aloha": ("slot", "guard"), "csma": ("slot", "guard"), "tdma": ("backoff",)}
    for key in others[section.mac]:
        if getattr(section, key) is not None:
            other = "aloha and csma" if section.mac == "tdma" else "tdma"
            report.add((*at, key), f"has no effect on mac {section.mac}: it belongs to {other}", key=True)
    if section.mac == "tdma" and section.slot is None:
        report.add_missing(at, "slot", ", which mac tdma needs")
    for key in ("slot", "backoff"):
        if getattr(section, key):
            whole_multiple(report, (*at, key), getattr(section, key), spec.tick)
    _water(parts, report, section)
    if section.sound_speed is not None and not 100.0 <= section.sound_speed <= 10_000.0:
        report.add((*at, "sound_speed"), f"must be between 100 and 10000 m/s, is {section.sound_speed:g}")
    if section.wind > 100.0:
        report.add((*at, "wind"), f"must be at most 100 m/s, is {section.wind:g}")
    _modems(parts, report, section)
    if section.ranging is not None:
        _ranging(parts, report, section, section.ranging)
    fading = section.fading
    if fading is not None and fading.correlation is not None and fading.shadowing is None:
        report.add((*at, "fading", "correlation"), "has no effect without shadowing", key=True)


def _water(parts: Parts, report: Report, section: AcousticSection) -> None:
    """Temperature and depth together, within the formula's limits; a site that can be read."""
    water, at = section.water, ("network", "acoustic")
    if water is None:
        return
    given = [key for key in ("temperature", "salinity", "depth") if getattr(water, key) is not None]
    if section.sound_speed is not None and given:
        report.add((*at, "sound_speed"), "either a speed or the water that it follows from, not both", key=True)
    if given or water.site is None:
        for key in ("temperature", "depth"):
            if key not in given:
                report.add_missing((*at, "water"), key, ", which the speed of sound needs")
    for key, low, high, unit in (("temperature", 2, 30, "degC"), ("salinity", 25, 40, "ppt"), ("depth", 0, 8000, "m")):
        value = getattr(water, key)
        if value is not None and not low <= value <= high:
            text = f"{value:g} {unit} is outside {low} to {high} {unit}, for which the formula was made"
            report.add((*at, "water", key), text, "give sound_speed instead")
    if water.site is not None:
        try:
            load_site(water.site, parts.folder)
        except DataFileError as error:
            for problem in error.problems:
                report.add((*at, "water", "site"), problem)


def _ranging(parts: Parts, report: Report, section: AcousticSection, ranging: RangingSection) -> None:
    """Requests have an effect, fit into a packet and a slot, and do not meet acknowledgements."""
    at = ("network", "acoustic", "ranging")
    if ranging.method == "one-way":
        for key in ("request", "turn"):
            if getattr(ranging, key) is not None:
                report.add((*at, key), "has no effect on method one-way: it belongs to two-way", key=True)
        return
    for chosen in (section, *section.modems.values()):
        try:
            values = modem_values(chosen, parts.folder)
        except DataFileError:
            continue  # reported with the modem
        if modem_problems(values):
            continue
        modem = modem_of(values)
        if modem.tries:
            report.add((*at, "method"), "two-way needs modems that do not acknowledge (tries: 0)", "method: one-way")
            return
        if (size := ranging.request or DEFAULT_REQUEST) > modem.mtu:
            report.add((*at, "request"), f"{size} bytes are longer than the mtu of a modem, {modem.mtu} bytes")
            return


def _modems(parts: Parts, report: Report, section: AcousticSection) -> None:
    """The values of each modem, and whether all share a band."""
    at = ("network", "acoustic")
    named: set[int] = set()
    for numbers in section.modems:
        vehicles_exist(parts.spec, report, (*at, "modems", numbers), numbers)
        if twice := sorted(named.intersection(vehicle_numbers(numbers))):
            report.add((*at, "modems", numbers), f"vehicle {twice[0]} has a modem already", key=True)
        named |= set(vehicle_numbers(numbers))
    places: list[tuple[tuple[str, ...], ModemSection]] = [(at, section)]
    places += [((*at, "modems", numbers), other) for numbers, other in section.modems.items()]
    good: list[Modem] = []
    for path, chosen in places:
        try:
            values = modem_values(chosen, parts.folder)
            wrong = modem_problems(values)
        except DataFileError as error:
            wrong = error.problems
        for problem in wrong:
            report.add((*path, "modem"), problem)
        for key in ("bit_rate", "preamble"):
            if getattr(chosen, key) is not None and chosen.airtime is not None:
                report.add((*path, key), "has no effect beside airtime", key=True)
        if wrong:
            continue
        modem = modem_of(values)
        if good and not modem.shares_band(good[0]):
            bands = " and ".join(f"{m.carrier / 1e3:g} kHz ({m.bandwidth / 1e3:g} kHz wide)" for m in (good[0], modem))
            report.add((*path, "modem"), f"does not share a band with the others: {bands}")
        good.append(modem)


def talking(parts: Parts, report: Report) -> None:
    """The payload fits into a packet, and with its guard into a slot; sound crosses the formation within the guard."""
    spec = parts.spec
    section = spec.network.acoustic
    if section is None:
        return
    at = ("network", "acoustic")
    try:
        if modem_problems(parts.modem_values):
            return
        modem = parts.modem
    except DataFileError:
        return  # reported already
    codec, size = spec.network.payload, SIZES[spec.network.payload]
    built_in = any(choice.whole_agent is None for _, choice in parts.choices())
    if built_in and size > modem.mtu:
        compact = SIZES["compact"]
        hint = f"network.payload: compact has {compact} bytes" if codec == "full" and compact <= modem.mtu else ""
        report.add(
            (*at, "modem"), f"the {codec} payload of {size} bytes is longer than its mtu, {modem.mtu} bytes", hint
        )
        return
    extent = extent_m(parts.plans)
    crossing = extent / speed_of_sound(section)
    if modem.tries:
        answer = 2 * crossing + modem.processing + modem.airtime_ns(modem.acknowledgement) / 1e9
        if modem.timeout < answer + spec.tick / 1e9:
            across = f"over the {extent:.4g} m of the formation"
            text = f"{modem.timeout:g} s are too short: an acknowledgement takes {answer:.4g} s {across}"
            path = (*at, "timeout" if section.timeout is not None else "modem")
            report.add(path, text, f"at least {answer + spec.tick / 1e9:.3g} s")
    if section.mac != "tdma" or section.slot is None:
        return
    airtime, guard = modem.airtime_ns(size) if built_in else modem.airtime_ns(0), guard_ns(section)
    turns, asked = 0, ""
    if section.ranging is not None and section.ranging.method == "two-way":
        senders = [src for src, _ in parts.links]
        most = max(map(senders.count, set(senders)), default=0)
        turns, asked = most * turn_ns(section.ranging, modem), f", {most} receivers take turns to measure their range"
    if airtime + turns + guard > section.slot:
        text = (
            f"{show_time(section.slot)} are too short: {size} bytes are {airtime / 1e9:g} s on the air{asked}, "
            f"and the guard is {show_time(guard)}"
        )
        report.add((*at, "slot"), text, f"at least {(airtime + turns + guard) / 1e9:g} s")
    if crossing * 1e9 > guard:
        text = (
            f"{show_time(guard)} are too short: sound takes {crossing:.4g} s over the {extent:.4g} m of the formation"
        )
        report.add((*at, "guard" if section.guard is not None else "slot"), text, "a longer guard")
