"""The configuration of the acoustic channel: modem, medium access, and the water between the vehicles."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Literal

from netem import propagation
from netem.curve import Curve

Method = Literal["one-way", "two-way"]


@dataclass(frozen=True, slots=True)
class RangingConfig:
    """How modems measure ranges."""

    method: Method = "one-way"
    noise: float = 0.5  # m, standard deviation
    outliers: float = 0.0  # probability
    excess: float = 0.0  # m, by which an outlier is too long on average
    request: int = 0  # bytes of a request, and of a reply; two-way
    turn_ns: int = 0  # after which the next receiver of the same packet sends its request; two-way


Mac = Literal["aloha", "csma", "tdma"]

DEFAULT_GUARD_NS = 100_000_000  # sound travels 150 m meanwhile
SOUND_SPEED = 1500.0  # m/s


@dataclass(frozen=True, slots=True)
class Modem:
    """The numbers of a modem. `netem/modems/*.toml` has the modems that ship, with their sources.

    A modem with `airtime` needs no `bit_rate` and no `preamble`; one with `delivery` needs no `lost_below` and no
    `clear_above`. One with `tries` sends each payload to one neighbour after the other, until it is acknowledged.
    """

    bit_rate: float  # bit/s, of the payload
    preamble: float  # s, everything on the air that is not payload
    carrier: float  # Hz
    bandwidth: float  # Hz
    source_level: float  # dB re 1 uPa at 1 m
    directivity: float  # dB, of the receiver
    max_range: float  # m: nothing is decoded beyond it
    interference_range: float  # m: nothing is disturbed beyond it
    mtu: int  # bytes: the longest payload
    lost_below: float  # dB: at or below this signal-to-noise ratio nothing is decoded
    clear_above: float  # dB: at or above it everything is
    capture: float  # dB: by how much a signal must exceed the sum of those that overlap it
    processing: float = 0.0  # s, from the end of a reception until the payload is there
    tries: int = 0  # how often a payload is sent at most until it is acknowledged; 0: once, without acknowledgement
    timeout: float = 0.0  # s, from the end of a transmission until the next try
    acknowledgement: int = 0  # bytes of an acknowledgement
    airtime: Curve | None = None  # s over bytes: as measured, in place of bit_rate and preamble
    delivery: Curve | None = None  # share decoded over distance [m]: as measured, in place of noise
    captured: Curve | None = None  # share decoded over signal to interference [dB]: in place of `capture`

    def airtime_ns(self, size: int) -> int:
        """How long a payload of `size` bytes is on the air, in whole nanoseconds."""
        if self.airtime is not None:
            return round(self.airtime.at(size) * 1e9)
        return round(self.preamble * 1e9) + -(-8 * size * 10**12 // round(self.bit_rate * 1000))

    def largest(self, room_ns: int) -> int:
        """The bytes of the longest payload that is on the air for at most `room_ns`; 0 if none is."""
        return max(0, bisect_right(range(self.mtu + 1), room_ns, key=self.airtime_ns) - 1)

    def survives(self, excess_db: float) -> float:
        """The share of receptions that others do not spoil, if the signal is `excess_db` above their sum."""
        if self.captured is not None:
            return self.captured.at(excess_db)
        return float(excess_db >= self.capture)

    def shares_band(self, other: Modem) -> bool:
        """Whether the bands of two modems overlap."""
        return 2.0 * abs(self.carrier - other.carrier) < self.bandwidth + other.bandwidth


@dataclass(frozen=True, slots=True)
class AcousticConfig:
    """An acoustic channel: the modems of the vehicles, when each may talk, and the water between them."""

    modem: Modem
    mac: Mac = "aloha"
    backoff_ticks: int = 0  # aloha, csma: a start is this late at most, drawn uniformly
    slot_ticks: int = 0  # tdma: vehicle after vehicle, in the order of their numbers
    guard_ns: int = DEFAULT_GUARD_NS  # tdma: of each slot, kept silent for propagation
    buffer: int = 1  # payloads that wait in a modem
    refuses: bool = False  # True: what comes when the buffer is full is lost; False: it replaces the oldest
    sound_speed: float = SOUND_SPEED  # m/s
    water: propagation.SeaWater | None = None  # the water that absorbs sound; None: Thorp's, of 4 deg C
    spreading: float = 1.5  # 1 cylindrical, 1.5 practical, 2 spherical
    excess: float = 0.0  # dB, lost in addition to spreading and absorption
    shipping: float = 0.5  # 0 none, 1 heavy
    wind: float = 5.0  # m/s
    shadowing: float = 0.0  # dB, standard deviation of the slow gain of a directed link
    shadowing_ns: int = 0  # after which its correlation is 1/e; 0: it never changes
    rician: float | None = None  # of each packet: power of the steady path over the scattered; 0 Rayleigh, None: none
    modems: dict[int, Modem] = field(default_factory=dict)  # modems of the vehicles that carry another one
    ranging: RangingConfig | None = None  # None: modems measure no ranges

    def modem_of(self, vehicle: int) -> Modem:
        return self.modems.get(vehicle, self.modem) if self.modems else self.modem

    def longest(self, tick_ns: int, vehicle: int | None = None) -> int:
        """The bytes of the longest payload that the modem of a vehicle takes, and a slot with its guard holds."""
        modem = self.modem if vehicle is None else self.modem_of(vehicle)
        if self.mac != "tdma":
            return modem.mtu
        return modem.largest(self.slot_ticks * tick_ns - self.guard_ns)

    def longest_access_s(self, tick_ns: int, vehicles: int) -> float:
        """The longest that a free modem waits for its turn to talk [s], in a fleet of so many."""
        return max(self.backoff_ticks, vehicles * self.slot_ticks) * tick_ns / 1e9

    def noise_level(self, receiver: Modem | None = None) -> float:
        """Noise in the band of a modem [dB re 1 uPa]."""
        modem = self.modem if receiver is None else receiver
        return propagation.noise_level(modem.carrier / 1e3, modem.bandwidth, self.shipping, self.wind)

    def received_level(self, range_m: float, sender: Modem | None = None) -> float:
        """The level [dB re 1 uPa] of a modem's signal at a range [m]."""
        modem = self.modem if sender is None else sender
        loss = propagation.transmission_loss(range_m, modem.carrier / 1e3, self.spreading, self.water)
        return modem.source_level - loss - self.excess

    def packet_error_rate(
        self,
        range_m: float,
        size: int,
        sender: Modem | None = None,
        receiver: Modem | None = None,
        gain_db: float = 0.0,
    ) -> float:
        """The probability that a payload of `size` bytes cannot be decoded at a range [m], if no other modem talks.
        `gain_db`: what fading adds to the level at this moment."""
        modem = self.modem if receiver is None else receiver
        if modem.delivery is not None:
            return 1.0 - modem.delivery.at(range_m)
        snr = self.snr(range_m, sender, receiver) + gain_db
        return propagation.packet_error_rate(snr, 8 * size, modem.lost_below, modem.clear_above)

    def snr(self, range_m: float, sender: Modem | None = None, receiver: Modem | None = None) -> float:
        modem = self.modem if receiver is None else receiver
        return self.received_level(range_m, sender) - (self.noise_level(receiver) - modem.directivity)

    def delay_ns(self, range_m: float) -> int:
        """How long sound takes over a range [m], rounded to nanoseconds."""
        return round(range_m / self.sound_speed * 1e9)
