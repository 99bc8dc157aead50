"""Rules on links and on the acoustic channel."""

from __future__ import annotations

from fleet.quantities import show_time, vehicle_numbers
from fleet.scenario.parts import Parts
from fleet.scenario.rules.report import Report, known_links, vehicles_exist, whole_multiple
from fleet.scenario.schema.network import AcousticSection, ModemSection, RangingSection
from fleet.scenario.schema.spec import sections
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
from fleet.scenario.sections.modem_files import modem_of, modem_problems
from fleet.scenario.sections.site_files import load_site
from netem.condition import Condition
from netem.errors import TextError
from netem.grammar import print_condition
from netem.link_selector import parse_selector
from netem.modem import Modem


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
    if section.queue is not None and report.has((*at, "buffer")):
        report.add((*at, "queue"), "waits in place of buffer: give one of them", key=True)
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
    # What programs of others say has any length; their modems tell them the longest.
    built_in = spec.nodes is None and any(choice.whole_agent is None for _, choice in parts.choices())
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
    least, guard = size if built_in else 1, guard_ns(section)
    airtime = modem.airtime_ns(least)
    turns, asked = 0, ""
    if section.ranging is not None and section.ranging.method == "two-way":
        senders = [src for src, _ in parts.links]
        most = max(map(senders.count, set(senders)), default=0)
        turns, asked = most * turn_ns(section.ranging, modem), f", {most} receivers take turns to measure their range"
    if airtime + turns + guard > section.slot:
        text = (
            f"{show_time(section.slot)} are too short: {least} byte{'s are' if least > 1 else ' is'} "
            f"{airtime / 1e9:g} s on the air{asked}, "
            f"and the guard is {show_time(guard)}"
        )
        report.add((*at, "slot"), text, f"at least {(airtime + turns + guard) / 1e9:g} s")
    if crossing * 1e9 > guard:
        text = (
            f"{show_time(guard)} are too short: sound takes {crossing:.4g} s over the {extent:.4g} m of the formation"
        )
        report.add((*at, "guard" if section.guard is not None else "slot"), text, "a longer guard")


def ideal(parts: Parts, report: Report) -> None:
    """Without a network in between, all agents are in one process, and none can be late, gone or somewhere else."""
    spec = parts.spec
    if spec.network.ideal and spec.on_controller_error == "die":
        message = "the others of an ideal network wait for everybody, also for an agent that is gone"
        report.add(("on_controller_error",), message, "abort, coast, or give the network a period")
    if spec.network.ideal and spec.agents.per_process not in ("auto", 1):
        message = "nobody shares a process on an ideal network, which runs in one"
        report.add(("agents", "per_process"), message, "leave it out, or give the network a period")
    for path, external in sections(parts.spec, "external"):
        if external and spec.network.ideal:
            message = "nobody can join an ideal network, which runs in one process"
            report.add((*path, "external"), message, "give the network a period")
