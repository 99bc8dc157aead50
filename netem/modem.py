"""The configuration of the acoustic channel: modem, medium access, and the water between the vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from netem import propagation

Mac = Literal["aloha", "tdma"]

DEFAULT_GUARD_NS = 100_000_000  # sound travels 150 m meanwhile
SOUND_SPEED = 1500.0  # m/s


@dataclass(frozen=True, slots=True)
class Modem:
    """The numbers of a modem; `netem/modems/*.toml` has those that ship, with their sources."""

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

    def airtime_ns(self, size: int) -> int:
        """How long a payload of `size` bytes is on the air, rounded up to nanoseconds."""
        return round(self.preamble * 1e9) + -(-8 * size * 10**12 // round(self.bit_rate * 1000))


@dataclass(frozen=True, slots=True)
class AcousticConfig:
    """An acoustic channel: one modem for all vehicles, when each may talk, and the water between them."""

    modem: Modem
    mac: Mac = "aloha"
    backoff_ticks: int = 0  # aloha: a start is this late at most, drawn uniformly
    slot_ticks: int = 0  # tdma: vehicle after vehicle, in the order of their numbers
    guard_ns: int = DEFAULT_GUARD_NS  # tdma: of each slot, kept silent for propagation
    buffer: int = 1  # payloads that wait in a modem
    sound_speed: float = SOUND_SPEED  # m/s
    spreading: float = 1.5  # 1 cylindrical, 1.5 practical, 2 spherical
    shipping: float = 0.5  # 0 none, 1 heavy
    wind: float = 5.0  # m/s

    def longest(self, tick_ns: int) -> int:
        """The bytes of the longest payload that the modem takes, and a slot with its guard holds."""
        if self.mac != "tdma":
            return self.modem.mtu
        room = self.slot_ticks * tick_ns - self.guard_ns - self.modem.airtime_ns(0)
        size = max(0, int(room * self.modem.bit_rate / 8e9)) + 1
        while size and self.modem.airtime_ns(size) > self.slot_ticks * tick_ns - self.guard_ns:
            size -= 1
        return min(self.modem.mtu, size)

    def noise_level(self) -> float:
        """Noise in the modem's band [dB re 1 uPa]."""
        return propagation.noise_level(self.modem.carrier / 1e3, self.modem.bandwidth, self.shipping, self.wind)

    def received_level(self, range_m: float) -> float:
        """The level [dB re 1 uPa] of a modem's signal at a range [m]."""
        loss = propagation.transmission_loss(range_m, self.modem.carrier / 1e3, self.spreading)
        return self.modem.source_level - loss

    def packet_error_rate(self, range_m: float, size: int) -> float:
        """The probability that noise alone makes a payload of `size` bytes undecodable at a range [m]."""
        modem = self.modem
        return propagation.packet_error_rate(self.snr(range_m), 8 * size, modem.lost_below, modem.clear_above)

    def snr(self, range_m: float) -> float:
        """The signal-to-noise ratio [dB] at a range [m]."""
        return self.received_level(range_m) - (self.noise_level() - self.modem.directivity)

    def delay_ns(self, range_m: float) -> int:
        """How long sound takes over a range [m], rounded to nanoseconds."""
        return round(range_m / self.sound_speed * 1e9)
