"""The acoustic section of a scenario: the configuration of the channel.

| symbol | meaning | unit |
|---|---|---|
| T | airtime of a payload: preamble + 8 * (size in bytes) / (bit rate) | s |
| n | number of vehicles | 1 |
| B | largest back-off of `aloha` | s |
| G | load: mean number of transmissions that begin during one airtime | 1 |

The throughput of pure ALOHA is highest at G = 1/2, where it is 1/(2e) (N. Abramson, "The ALOHA system", AFIPS 1970).
A vehicle that always has a state to send starts a transmission every T + B/2 on average: G = n T / (T + B/2). G = 1/2
gives B = 2 T (2 n - 1), the default. This formula holds for many vehicles. The module `turns` computes how often they
send for any number of vehicles, and also if a vehicle sometimes has no state to send.
"""

from __future__ import annotations

from math import sqrt
from pathlib import Path
from typing import TypeVar

from agents import compact, payload
from agents.config import Codec
from agents.localization import payload as located
from agents.offset import Offset
from fleet.scenario.schema.network import AcousticSection, FadingSection, ModemSection, NetworkSection, RangingSection
from fleet.scenario.sections.modem_files import CURVES, NUMBERS, Values, load_modem, merge_values, without_replaced
from fleet.scenario.sections.site_files import load_site
from netem.modem import DEFAULT_GUARD_NS, SOUND_SPEED, AcousticConfig, Modem, RangingConfig
from netem.propagation import SeaWater, sound_speed

DEFAULT_MODEM: str = AcousticSection.model_construct().modem
DEFAULT_SPREADING = 1.5
DEFAULT_SALINITY = 35.0  # ppt
DEFAULT_REQUEST = 4  # bytes, of two-way ranging
_Modem = TypeVar("_Modem", bound=ModemSection)
_KEYS = (*NUMBERS, *CURVES)
_TIMES = ("preamble", "processing", "timeout")  # nanoseconds in a section
SIZES: dict[Codec, int] = {"full": payload.SIZE, "compact": compact.SIZE, "located": located.SIZE}


def modem_values(section: ModemSection, folder: Path | None) -> Values:
    """The values of a section's modem, as in `netem.modem.Modem`: those of its file, unless the section gives others.

    Raises DataFileError: the modem file is missing or wrong.
    """
    base = load_modem(section.modem, folder)
    given = {key: getattr(section, key) for key in _KEYS if getattr(section, key) is not None}
    changes = {key: value / 1e9 if key in _TIMES else value for key, value in given.items()}
    return merge_values({key: getattr(base, key) for key in _KEYS}, changes)


def inlined_modem(section: _Modem, folder: Path | None) -> _Modem:
    """The same section with all values of the modem in it: it does not need the modem file. Raises DataFileError."""
    values = modem_values(section, folder)
    shown = without_replaced(values)
    written = {key: round(value * 1e9) if key in _TIMES else value for key, value in shown.items()}
    return section.model_copy(update={"modem": DEFAULT_MODEM, **written})


def compile_acoustic(
    section: AcousticSection,
    modem: Modem,
    codec: Codec,
    vehicles: int,
    tick_ns: int,
    modems: dict[int, Modem],
    folder: Path | None = None,
) -> AcousticConfig:
    """The configuration of the channel that a valid section describes; back-off and slot in whole ticks.

    `modems`: of the vehicles that carry another one. Raises DataFileError: the site's file is missing or wrong.
    """
    backoff = backoff_ns(section, modem, codec, vehicles) if section.mac != "tdma" else 0
    site = load_site(section.water.site, folder) if section.water and section.water.site is not None else None
    fading = section.fading
    if fading is None and site is not None:
        fading = FadingSection.model_construct(shadowing=site.shadowing, packets=site.rician)
    fading = fading or FadingSection()
    return AcousticConfig(
        modem=modem,
        mac=section.mac,
        backoff_ticks=-(-backoff // tick_ns),
        slot_ticks=(section.slot or 0) // tick_ns,
        guard_ns=guard_ns(section),
        buffer=section.queue or section.buffer,
        refuses=section.queue is not None,
        sound_speed=speed_of_sound(section),
        water=known_water(section),
        spreading=section.spreading or (site.spreading if site is not None else DEFAULT_SPREADING),
        excess=0.0 if site is None else site.excess,
        shipping=section.shipping,
        wind=section.wind,
        shadowing=fading.shadowing or 0.0,
        shadowing_ns=fading.correlation or 0,
        rician=fading.packets,
        modems=modems,
        ranging=None if section.ranging is None else _ranging(section.ranging, modem),
    )


def _ranging(section: RangingSection, modem: Modem) -> RangingConfig:
    outliers, request = section.outliers, DEFAULT_REQUEST if section.request is None else section.request
    return RangingConfig(
        method=section.method,
        noise=section.noise,
        outliers=0.0 if outliers is None else outliers.probability,
        excess=0.0 if outliers is None else outliers.excess,
        request=request if section.method == "two-way" else 0,
        turn_ns=turn_ns(section, modem) if section.method == "two-way" else 0,
    )


def turn_ns(section: RangingSection, modem: Modem) -> int:
    """From the request of one receiver to that of the next [ns]: from the section, or both ways over 150 m."""
    request = DEFAULT_REQUEST if section.request is None else section.request
    return 2 * (modem.airtime_ns(request) + DEFAULT_GUARD_NS) if section.turn is None else section.turn


def backoff_ns(section: AcousticSection, modem: Modem, codec: Codec, vehicles: int) -> int:
    """The largest back-off [ns]: from the section, or by default 2 T (2 n - 1) for payloads of the built-in agents.

    Programs with a queue decide themselves when they talk. So a modem starts at once, as real ones do; with csma within
    twice the airtime of its longest payload, which is an assumption.
    """
    if section.backoff is not None:
        return section.backoff
    if section.queue is not None:
        return 2 * modem.airtime_ns(modem.mtu) if section.mac == "csma" else 0
    return 2 * modem.airtime_ns(SIZES[codec]) * (2 * vehicles - 1)


def guard_ns(section: AcousticSection) -> int:
    """The silent part at the end of a slot [ns]: from the section, or the default."""
    return DEFAULT_GUARD_NS if section.guard is None else section.guard


def speed_of_sound(section: AcousticSection) -> float:
    """The speed of sound [m/s]: from the water's properties, or as given, or by default 1500."""
    if (water := known_water(section)) is not None:
        return sound_speed(water)
    return SOUND_SPEED if section.sound_speed is None else section.sound_speed


def known_water(section: AcousticSection) -> SeaWater | None:
    """The water whose properties a section gives. None: it gives none, or a site, whose loss was fitted with Thorp."""
    water = section.water
    if water is None or water.temperature is None or water.depth is None:
        return None
    return SeaWater(water.temperature, DEFAULT_SALINITY if water.salinity is None else water.salinity, water.depth)


def extent_m(plans: tuple[Offset, ...]) -> float:
    """An upper bound on the distance [m] of two vehicles in formation: the diagonal of the formation's bounding box.

    A formation that changes has several boxes: one at the start, and one after each change. The largest counts.

    `plans`: the offset of each vehicle in the formation [m, NED].
    """
    longest = 0.0
    stages = [[plan.start for plan in plans]]
    stages += [[plan.changes[n].offset for plan in plans] for n in range(len(plans[0].changes) if plans else 0)]
    for places in stages:
        sides = [max(place[axis] for place in places) - min(place[axis] for place in places) for axis in range(3)]
        longest = max(longest, sqrt(sum(side * side for side in sides)))
    return longest


def describe_noise(network: NetworkSection, acoustic: AcousticConfig, plans: tuple[Offset, ...]) -> str:
    """One line of text: whether packets are lost in noise, and beyond which range."""
    modem, size = acoustic.modem, SIZES[network.payload]
    if modem.delivery is not None:
        extent = extent_m(plans)
        share = 100 * modem.delivery.at(extent)
        return (
            f"delivery as measured: {share:.3g}% of the packets arrive over {extent:.4g} m, the largest distance in "
            "the formation"
        )
    snr = acoustic.snr(modem.max_range)
    if acoustic.packet_error_rate(modem.max_range, size) == 0.0:
        return (
            f"noise loses no packet (cause snr). At the modem's range of {modem.max_range:.4g} m the signal is "
            f"{snr:.3g} dB above the noise, and {modem.clear_above:g} dB are enough"
        )
    extent = extent_m(plans)
    across = 100 * acoustic.packet_error_rate(extent, size)
    some, half = (_range_of(acoustic, size, share) for share in (0.01, 0.5))
    steady = ", if levels did not fade" if acoustic.shadowing or acoustic.rician is not None else ""
    return (
        f"noise loses packets of {size} bytes (cause snr){steady}: 1% at {some:.4g} m, 50% at {half:.4g} m, "
        f"and {across:.3g}% at {extent:.4g} m, the largest distance in the formation"
    )


def _range_of(acoustic: AcousticConfig, size: int, share: float) -> float:
    """The range [m] beyond which more than `share` of the packets are lost in noise; at most the modem's max_range."""
    near, far = 0.0, acoustic.modem.max_range
    for _ in range(60):
        middle = (near + far) / 2.0
        near, far = (near, middle) if acoustic.packet_error_rate(middle, size) > share else (middle, far)
    return far
