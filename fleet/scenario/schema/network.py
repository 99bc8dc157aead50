"""The network: links or an acoustic channel."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from agents.config import Codec
from fleet.quantities import describe_value, show_time
from fleet.scenario import value_types as v
from fleet.scenario.value_types import Section, mistake, read_condition, word_for
from netem.condition import Condition
from netem.grammar import print_condition
from netem.link_presets import link_presets
from netem.modem import Method
from netem.parsing import nearest, quoted


class WaterSection(Section):
    """The properties of water that determine the speed of sound, or a site with measured properties."""

    temperature: v.Temperature | None = None
    salinity: v.Salinity | None = None  # 35 ppt
    depth: v.Length | None = None
    site: str | None = None  # shipped, or a TOML file: spreading, further loss, and fading


class ModemSection(Section):
    """A modem, shipped or a TOML file, and changes of its numbers."""

    modem: str = "s2c"
    bit_rate: v.BitRate | None = None
    preamble: v.Time | None = None
    carrier: v.Frequency | None = None
    bandwidth: v.Frequency | None = None
    source_level: v.Level | None = None  # re 1 uPa at 1 m
    directivity: v.Level | None = None
    max_range: v.PositiveLength | None = None
    interference_range: v.Length | None = None
    mtu: v.Bytes | None = None
    lost_below: v.Level | None = None
    clear_above: v.Level | None = None
    capture: v.Level | None = None
    processing: v.Time | None = None
    tries: Annotated[int, Field(ge=0, le=100)] | None = None
    timeout: v.Time | None = None
    acknowledgement: v.NoBytes | None = None
    airtime: v.AirtimeCurve | None = None  # as measured, over the size
    delivery: v.DeliveryCurve | None = None  # as measured, over the distance
    captured: v.CaptureCurve | None = None  # as measured, over signal to interference


class FadingSection(Section):
    """How the level of a directed link varies: slowly (log-normal shadowing), and from packet to packet."""

    shadowing: v.PositiveLevel | None = None  # standard deviation
    correlation: v.Period | None = None  # time after which the shadowing's correlation is 1/e; never, if it is left out
    packets: v.Scatter | None = None


class OutlierSection(Section):
    """Ranges that are too long, since the straight way was missed."""

    probability: v.Probability
    excess: v.PositiveLength = 20.0  # by which they are too long, on average; exponentially distributed


class RangingSection(Section):
    """The modems' measurement of the distance to the sender of a packet."""

    method: Method = "one-way"
    noise: v.PositiveLength = 0.5  # standard deviation
    outliers: OutlierSection | None = None
    request: v.Bytes | None = None  # two-way: of a request, and of a reply; 4 bytes
    turn: v.Period | None = None  # two-way: from the request of one receiver to the request of the next


class AcousticSection(ModemSection):
    """The acoustic channel: the modems, the medium access, and the water."""

    modems: dict[v.VehicleNumbers, Annotated[ModemSection, word_for("modem")]] = {}  # vehicles that carry another modem
    mac: Literal["aloha", "csma", "tdma"] = "aloha"
    # aloha, csma: the largest; default: aloha has its highest throughput, and with a queue no wait.
    backoff: v.Time | None = None
    slot: v.Period | None = None  # tdma
    guard: v.Time | None = None  # tdma; 100 ms
    buffer: Annotated[int, Field(ge=1, le=1000)] = 1  # payloads that wait; a new one replaces the oldest
    queue: Annotated[int, Field(ge=1, le=1000)] | None = None  # in place of it: a new one is refused when so many wait
    sound_speed: v.PositiveSpeed | None = None  # 1500 m/s
    water: WaterSection | None = None  # in place of a speed
    spreading: v.Spreading | None = None  # default: the spreading of the site, or 1.5
    shipping: v.Fraction = 0.5
    wind: v.Speed = 5.0
    fading: FadingSection | None = None
    ranging: Annotated[RangingSection | None, word_for("method")] = None  # modems measure none


_ALL_DEFAULTS = BeforeValidator(lambda value: {} if value is None else value)


class LinkStateSection(Section):
    """A state of links: the condition in it, and how long it lasts on average."""

    condition: v.LinkCondition = Condition()
    mean: v.Period  # mean of the exponentially distributed time in the state
    next: dict[v.StateName, v.Probability] | None = None  # the state that follows; by default any other


class LinkSection(Section):
    """The effect of some links on packets: one condition, states that change by themselves, or measured rows."""

    condition: v.LinkCondition | None = None
    preset: str | None = None  # a condition that ships, by its name; the merged scenario has its words
    states: dict[v.StateName, LinkStateSection] | None = None
    together: bool | None = None  # states: the links of this selector change at the same times
    trace: str | None = None  # CSV; a text of several lines is the CSV itself
    by: Literal["time", "packet"] | None = None  # time
    start: v.Time | None = None  # where the trace begins; default: its first row
    loop: bool | None = None
    offset: Literal["random"] | None = None  # with loop: for each link another place, drawn from the seed
    time_scale: v.PositiveNumber | None = None  # seconds of the run per second of the trace; 1
    lost_below: v.Level | None = None  # with a trace that has snr: at or below this level a packet is lost


def _preset(value: dict[str, Any]) -> Condition:
    """The condition of links with a preset."""
    name, presets = str(value["preset"]), link_presets()
    if name not in presets:
        raise mistake(
            f"there is no preset {quoted(name)}; there are {', '.join(presets)}", 0, nearest(name, presets) or ""
        )
    if others := [key for key in value if key != "preset"]:
        hint = f"write its words in place of it, and change them: {presets[name].condition}"
        raise mistake(f"a preset is a whole condition, and {others[0]} has no place beside it", 0, hint)
    return presets[name].parse()


def _link(value: Any) -> Any:
    """Links with one condition are given by its words alone, which keep their column in errors."""
    if isinstance(value, dict) and "preset" in value:
        return LinkSection.model_construct(condition=_preset(value))
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
    period: v.Period = 100_000_000  # one round: every agent sends once per period
    links: dict[v.LinkSelector, Annotated[LinkSection, BeforeValidator(_link)]] = {}  # the last for a link wins
    radios: dict[v.VehicleNumbers, v.LinkCondition] = {}  # rate and limit of all that a vehicle sends; the last wins
    acoustic: Annotated[
        AcousticSection | None, BeforeValidator(lambda value: {} if value is None else value), word_for("modem")
    ] = None  # in the water
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
    radios = {numbers: print_condition(radio) for numbers, radio in network.radios.items()}
    shown: dict[str, Any] = {"period": show_time(network.period)}
    if network.acoustic is not None:
        modem = {"modem": network.acoustic.modem}
        shown["acoustic"] = modem | network.acoustic.model_dump(exclude_none=True, exclude_defaults=True)
    return (
        shown
        | ({"links": links} if links else {})
        | ({"radios": radios} if radios else {})
        | ({"payload": network.payload} if network.payload != "full" else {})
    )
