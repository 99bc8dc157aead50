"""The network: links or an acoustic channel."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from agents.config import Codec
from fleet.quantities import describe_value, show_time
from fleet.scenario.schema.value_types import (
    AirtimeCurve,
    BitRate,
    Bytes,
    CaptureCurve,
    DeliveryCurve,
    Fraction,
    Frequency,
    Length,
    Level,
    LinkCondition,
    LinkSelector,
    NoBytes,
    Period,
    PositiveLength,
    PositiveLevel,
    PositiveNumber,
    PositiveSpeed,
    Probability,
    Salinity,
    Scatter,
    Section,
    Speed,
    Spreading,
    StateName,
    Temperature,
    Time,
    VehicleNumbers,
    mistake,
    read_condition,
)
from netem.condition import Condition
from netem.grammar import print_condition
from netem.modem import Method


class WaterSection(Section):
    """The properties of water that determine the speed of sound, or a site with measured properties."""

    temperature: Temperature | None = None
    salinity: Salinity | None = None  # 35 ppt
    depth: Length | None = None
    site: str | None = None  # shipped, or a TOML file: spreading, further loss, and fading


class ModemSection(Section):
    """A modem, shipped or a TOML file, and changes of its numbers."""

    modem: str = "s2c"
    bit_rate: BitRate | None = None
    preamble: Time | None = None
    carrier: Frequency | None = None
    bandwidth: Frequency | None = None
    source_level: Level | None = None  # re 1 uPa at 1 m
    directivity: Level | None = None
    max_range: PositiveLength | None = None
    interference_range: Length | None = None
    mtu: Bytes | None = None
    lost_below: Level | None = None
    clear_above: Level | None = None
    capture: Level | None = None
    processing: Time | None = None
    tries: Annotated[int, Field(ge=0, le=100)] | None = None
    timeout: Time | None = None
    acknowledgement: NoBytes | None = None
    airtime: AirtimeCurve | None = None  # as measured, over the size
    delivery: DeliveryCurve | None = None  # as measured, over the distance
    captured: CaptureCurve | None = None  # as measured, over signal to interference


class FadingSection(Section):
    """How the level of a directed link varies: slowly (log-normal shadowing), and from packet to packet."""

    shadowing: PositiveLevel | None = None  # standard deviation
    correlation: Period | None = None  # time after which the shadowing's correlation is 1/e; never, if it is left out
    packets: Scatter | None = None


class OutlierSection(Section):
    """Ranges that are too long, since the straight way was missed."""

    probability: Probability
    excess: PositiveLength = 20.0  # by which they are too long, on average; exponentially distributed


class RangingSection(Section):
    """The modems' measurement of the distance to the sender of a packet."""

    method: Method = "one-way"
    noise: PositiveLength = 0.5  # standard deviation
    outliers: OutlierSection | None = None
    request: Bytes | None = None  # two-way: of a request, and of a reply; 4 bytes
    turn: Period | None = None  # two-way: from the request of one receiver to that of the next


def _ranging(value: Any) -> Any:
    """Ranging may be given by its method alone."""
    return {"method": value} if isinstance(value, str) else value


def _modem(value: Any) -> Any:
    """A modem may be given by its name alone."""
    return {"modem": value} if isinstance(value, str) else value


class AcousticSection(ModemSection):
    """The acoustic channel: the modems, the medium access, and the water."""

    modems: dict[VehicleNumbers, Annotated[ModemSection, BeforeValidator(_modem)]] = {}  # of some vehicles
    mac: Literal["aloha", "csma", "tdma"] = "aloha"
    backoff: Time | None = None  # aloha, csma: the largest; by default that of the highest throughput of aloha
    slot: Period | None = None  # tdma
    guard: Time | None = None  # tdma; 100 ms
    buffer: Annotated[int, Field(ge=1, le=1000)] = 1  # payloads that wait
    sound_speed: PositiveSpeed | None = None  # 1500 m/s
    water: WaterSection | None = None  # in place of a speed
    spreading: Spreading | None = None  # that of the site, or 1.5
    shipping: Fraction = 0.5
    wind: Speed = 5.0
    fading: FadingSection | None = None
    ranging: Annotated[RangingSection | None, BeforeValidator(_ranging)] = None  # modems measure none


def _acoustic(value: Any) -> Any:
    """A modem may be given by its name alone, and an empty section has all defaults."""
    return {} if value is None else _modem(value)


class LinkStateSection(Section):
    """A state of links: the condition in it, and how long it lasts on average."""

    condition: LinkCondition = Condition()
    mean: Period  # of an exponentially distributed time
    next: dict[StateName, Probability] | None = None  # the state that follows; every other with the same probability


class LinkSection(Section):
    """The effect of some links on packets: one condition, states that change by themselves, or measured rows."""

    condition: LinkCondition | None = None
    states: dict[StateName, LinkStateSection] | None = None
    together: bool | None = None  # states: the links of this selector change at the same times
    trace: str | None = None  # CSV; a text of several lines is the CSV itself
    by: Literal["time", "packet"] | None = None  # time
    start: Time | None = None  # of the trace; by default its first row
    loop: bool | None = None
    offset: Literal["random"] | None = None  # with loop: for each link another place, drawn from the seed
    time_scale: PositiveNumber | None = None  # seconds of the run per second of the trace; 1
    lost_below: Level | None = None  # of a trace with snr: at or below it a packet is lost


def _link(value: Any) -> Any:
    """Links with one condition are given by its words alone, which keep their column in errors."""
    if isinstance(value, (dict, LinkSection)):
        return value
    return LinkSection.model_construct(condition=read_condition(value))


def show_link(link: LinkSection) -> Any:
    """The file's form of what some links do."""
    if link.condition is not None and link.model_fields_set == {"condition"}:
        return print_condition(link.condition)
    return link.model_dump(exclude_none=True)


class NetworkSection(Section):
    """The network between the agents; `network: ideal` in the file is `ideal` here."""

    ideal: bool = False
    period: Period = 100_000_000  # one round: every agent sends once per period
    links: dict[LinkSelector, Annotated[LinkSection, BeforeValidator(_link)]] = {}  # the last that matches a link wins
    acoustic: Annotated[AcousticSection | None, BeforeValidator(_acoustic)] = None  # in the water
    payload: Codec = "full"  # the encoding of the messages between built-in agents


def read_network(value: Any) -> Any:
    """The model's form of the section, which may be one word in the file."""
    if value == "ideal":
        return {"ideal": True}
    if value == "acoustic":
        return {"acoustic": {}}
    if isinstance(value, dict):
        if "ideal" in value:
            raise mistake('write "network: ideal" for the network without latency, which then is nothing else')
        return value
    raise mistake(f'expected a mapping with a period and links, or "ideal", or "acoustic", got {describe_value(value)}')


def show_network(network: NetworkSection) -> Any:
    """The file's form of the section."""
    if network.ideal:
        return "ideal"
    links = {selector: show_link(link) for selector, link in network.links.items()}
    shown: dict[str, Any] = {"period": show_time(network.period)}
    if network.acoustic is not None:
        modem = {"modem": network.acoustic.modem}
        shown["acoustic"] = modem | network.acoustic.model_dump(exclude_none=True, exclude_defaults=True)
    return (
        shown
        | ({"links": links} if links else {})
        | ({"payload": network.payload} if network.payload != "full" else {})
    )
