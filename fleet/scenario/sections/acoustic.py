"""The acoustic part of a scenario: the configuration of the channel, and how often vehicles can send on it.

| symbol | meaning | unit |
|---|---|---|
| T | airtime of a payload: preamble + 8 bytes / bit rate | s |
| n | vehicles | 1 |
| B | largest back-off of `aloha` | s |
| G | load: transmissions that begin during an airtime | 1 |

Pure ALOHA carries most, 1/(2e) of the time, at G = 1/2 (N. Abramson, "The ALOHA system", AFIPS 1970). A vehicle that
always has a state to send sends every T + B/2 on average, so G = n T / (T + B/2), and B = 2 T (2 n - 1) is the default.
That holds for many vehicles; `aloha` computes it for few vehicles, and for states that do not always wait.
"""

from __future__ import annotations

from math import sqrt
from pathlib import Path

from agents import compact, payload
from agents.config import Codec
from agents.offset import Offset
from fleet.scenario.schema.network import AcousticSection, NetworkSection
from fleet.scenario.sections.aloha import Talking, talking
from fleet.scenario.sections.modem_files import NUMBERS, load_modem
from netem.modem import DEFAULT_GUARD_NS, SOUND_SPEED, AcousticConfig, Modem
from netem.propagation import sound_speed

DEFAULT_MODEM: str = AcousticSection().modem
SIZES: dict[Codec, int] = {"full": payload.SIZE, "compact": compact.SIZE}


def modem_numbers(section: AcousticSection, folder: Path | None) -> dict[str, float]:
    """The numbers of a section's modem: those of its file, changed as the section says. Raises DataFileError."""
    base = load_modem(section.modem, folder).modem
    return {key: _given(section, key, getattr(base, key)) for key in NUMBERS}


def _given(section: AcousticSection, key: str, otherwise: float) -> float:
    value = getattr(section, key)
    return otherwise if value is None else value / 1e9 if key == "preamble" else value


def inlined_modem(section: AcousticSection, folder: Path | None) -> AcousticSection:
    """The same channel with every number of the modem written out, so that it no longer needs the modem's file."""
    values = modem_numbers(section, folder)
    written = {key: round(value * 1e9) if key == "preamble" else value for key, value in values.items()}
    return section.model_copy(update={"modem": DEFAULT_MODEM, **written})


def compile_acoustic(
    section: AcousticSection, modem: Modem, codec: Codec, vehicles: int, tick_ns: int
) -> AcousticConfig:
    """The configuration of the channel of a valid section.

    Args:
        codec: of the agents' payloads.
        vehicles: how many share the channel.
    """
    backoff = backoff_ns(section, modem, codec, vehicles) if section.mac == "aloha" else 0
    return AcousticConfig(
        modem=modem,
        mac=section.mac,
        backoff_ticks=-(-backoff // tick_ns),
        slot_ticks=(section.slot or 0) // tick_ns,
        guard_ns=guard_ns(section),
        buffer=section.buffer,
        sound_speed=speed_of_sound(section),
        spreading=section.spreading,
        shipping=section.shipping,
        wind=section.wind,
    )


def backoff_ns(section: AcousticSection, modem: Modem, codec: Codec, vehicles: int) -> int:
    """The largest back-off [ns]: the one given, or that of ALOHA's best load with the payloads of our agents."""
    if section.backoff is not None:
        return section.backoff
    return 2 * modem.airtime_ns(SIZES[codec]) * (2 * vehicles - 1)


def guard_ns(section: AcousticSection) -> int:
    """The silent part of a slot [ns]."""
    return DEFAULT_GUARD_NS if section.guard is None else section.guard


def speed_of_sound(section: AcousticSection) -> float:
    """The speed of sound [m/s]: given, or that of the water, or 1500."""
    water = section.water
    if water is not None:
        return sound_speed(water.temperature, water.salinity, water.depth)
    return SOUND_SPEED if section.sound_speed is None else section.sound_speed


def extent_m(plans: tuple[Offset, ...]) -> float:
    """The diagonal of the box that holds the formation whenever it is complete [m]: no two are farther apart."""
    longest = 0.0
    stages = [[plan.start for plan in plans]]
    stages += [[plan.changes[n].offset for plan in plans] for n in range(len(plans[0].changes) if plans else 0)]
    for places in stages:
        sides = [max(place[axis] for place in places) - min(place[axis] for place in places) for axis in range(3)]
        longest = max(longest, sqrt(sum(side * side for side in sides)))
    return longest


def turn_s(network: NetworkSection, acoustic: AcousticConfig, vehicles: int, tick_ns: int) -> tuple[float, float]:
    """The time from one transmission of a vehicle to its next: on average, and the longest [s]."""
    period = network.period / 1e9
    if acoustic.mac == "tdma":
        turn = vehicles * acoustic.slot_ticks * tick_ns / 1e9
        return max(period, turn), max(period, turn)
    airtime = acoustic.modem.airtime_ns(SIZES[network.payload]) / 1e9
    backoff = acoustic.backoff_ticks * tick_ns / 1e9
    return _talking(network, acoustic, vehicles, tick_ns).mean * tick_ns / 1e9, period + airtime + backoff


def _talking(network: NetworkSection, acoustic: AcousticConfig, vehicles: int, tick_ns: int) -> Talking:
    airtime = -(-acoustic.modem.airtime_ns(SIZES[network.payload]) // tick_ns)
    return talking(network.period // tick_ns, max(1, airtime), acoustic.backoff_ticks, vehicles)


def greatest_age_s(network: NetworkSection, acoustic: AcousticConfig, plans: tuple[Offset, ...], tick_ns: int) -> float:
    """The greatest age that a neighbour's state can have when it is used, if none is lost [s].

    A state waits for at most a round before it is sent, and is used until the next one of the same sender arrives.
    """
    airtime = acoustic.modem.airtime_ns(SIZES[network.payload]) / 1e9
    flight = extent_m(plans) / acoustic.sound_speed
    _, longest = turn_s(network, acoustic, len(plans), tick_ns)
    return network.period / 1e9 + longest + airtime + flight


def describe_turns(network: NetworkSection, acoustic: AcousticConfig, vehicles: int, tick_ns: int) -> str:
    """A line of text on the airtime and on how often each vehicle sends."""
    assert network.acoustic is not None
    size = SIZES[network.payload]
    airtime = acoustic.modem.airtime_ns(size) / 1e9
    mean, _ = turn_s(network, acoustic, vehicles, tick_ns)
    said = f"the {network.payload} payload of {size} bytes is {airtime:.4g} s on the air"
    line = f"acoustic {network.acoustic.modem}: {said}"
    if acoustic.mac == "tdma":
        slot = acoustic.slot_ticks * tick_ns / 1e9
        return f"{line}; with slots of {slot:g} s each vehicle talks every {mean:.4g} s"
    alone = _talking(network, acoustic, vehicles, tick_ns).alone
    return f"{line}; each vehicle talks every {mean:.4g} s on average, {alone:.0%} of it with nobody else"


def describe_noise(network: NetworkSection, acoustic: AcousticConfig, plans: tuple[Offset, ...]) -> str:
    """A line of text on whether noise loses packets, and from which range on."""
    modem, size = acoustic.modem, SIZES[network.payload]
    snr = acoustic.snr(modem.max_range)
    if acoustic.packet_error_rate(modem.max_range, size) == 0.0:
        return (
            f"noise loses no packet (cause snr): at the modem's range of {modem.max_range:.4g} m the signal is "
            f"{snr:.3g} dB above it, and {modem.clear_above:g} dB are enough"
        )
    extent = extent_m(plans)
    across = 100 * acoustic.packet_error_rate(extent, size)
    some, half = (_range_of(acoustic, size, share) for share in (0.01, 0.5))
    return (
        f"noise loses packets (cause snr): 1% of {size} bytes at {some:.4g} m, half at {half:.4g} m; "
        f"{across:.3g}% at {extent:.4g} m, the largest distance in the formation"
    )


def _range_of(acoustic: AcousticConfig, size: int, share: float) -> float:
    """The range [m] within the modem's beyond which noise loses more than a share of the packets."""
    near, far = 0.0, acoustic.modem.max_range
    for _ in range(60):
        middle = (near + far) / 2.0
        near, far = (near, middle) if acoustic.packet_error_rate(middle, size) > share else (middle, far)
    return far
