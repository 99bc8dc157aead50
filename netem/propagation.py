"""The physics of an acoustic link: speed of sound, absorption, noise, fading, and what a modem makes of the signal.

| symbol | meaning | unit |
|---|---|---|
| T, S, D | temperature, salinity, depth of the water | deg C, ppt, m |
| c | speed of sound | m/s |
| f | frequency | kHz |
| alpha(f) | absorption | dB/km |
| r, k | range; spreading: 1 cylindrical, 1.5 practical, 2 spherical | m, 1 |
| SL, TL, RL = SL - TL | source level, transmission loss, received level | dB re 1 uPa (SL: at 1 m) |
| N(f) | power spectral density of the ambient noise | dB re 1 uPa/sqrt(Hz) |
| s, w | shipping activity from 0 to 1; wind | 1, m/s |
| NL = N(fc) + 10 log10 B | noise within bandwidth B [Hz] round the carrier fc | dB re 1 uPa |
| DI | directivity index of the receiver | dB |
| SNR = SL - TL - (NL - DI) | signal-to-noise ratio, the passive sonar equation | dB |

| formula | source |
|---|---|
| c(T, S, D), the nine terms of `sound_speed` | [1]; 2 to 30 deg C, 25 to 40 ppt, down to 8000 m |
| alpha = 0.11 f^2/(1 + f^2) + 44 f^2/(4100 + f^2) + 2.75e-4 f^2 + 0.003 | Thorp, as in [2]; f >= 0.4 |
| alpha = 0.002 + 0.11 f^2/(1 + f^2) + 0.011 f^2 | Thorp; f < 0.4. Older releases of ns-3 have f for f^2, a slip |
| alpha = boric acid + magnesium sulphate + water, see `absorption` | Francois and Garrison [5]; pH 8, 0.2 to 1000 kHz |
| TL = 10 k log10(r / 1 m) + alpha r / 1000 | [2]; 0 within 1 m |
| turbulence 17 - 30 log10 f | Wenz as fitted by Coates, as in [3] |
| shipping 40 + 20 (s - 0.5) + 26 log10 f - 60 log10(f + 0.03) | likewise |
| wind 50 + 7.5 sqrt(w) + 20 log10 f - 40 log10(f + 0.4) | likewise |
| thermal -15 + 20 log10 f | likewise |
| N = 10 log10 of the sum of the four as powers | likewise |
| p = 1 / (2 + 10^(SNR/10)) | bit errors of non-coherent FSK in Rayleigh fading, before decoding [4] |
| P_d = p^d sum_(k<d) C(d-1+k, k) (1-p)^k | two code words at distance d, square-law combined [4] |
| P_b = sum_d B_d P_d, d = 12, 14, ..., 26 | union bound of the rate 1/2 code of constraint length 9 [4] |
| PER = 1 - (1 - P_b)^bits | a packet without further correction |

[1] K. V. Mackenzie, J. Acoust. Soc. Am. 70(3), 807-812, 1981. ns-3: [2] `uan-prop-model-thorp.cc`,
[3] `uan-noise-model-default.cc`, [4] `UanPhyPerUmodem` in `uan-phy-gen.cc`. [5] R. E. Francois, G. R. Garrison,
J. Acoust. Soc. Am. 72(6), 1879-1890, 1982.

ns-3 subtracts, in addition, the chance of one error among 288 bits: that is left out, since for shorter packets it
makes the probability negative.

Pure functions on doubles; `docs/guide/acoustic.md` says what is left out (multipath, Doppler, bending rays).

Fading is a slow gain (log-normal shadowing) and a fast one (Rician or Rayleigh), in decibels. Both belong to a directed
link and are pure functions of (seed, link, time). Nothing is remembered, so packets can be judged in any order.

| symbol | meaning | unit |
|---|---|---|
| sigma, tau | standard deviation of the shadowing; time after which its correlation is 1/e | dB, s |
| Z_n | independent standard normal numbers of a link, one per tau/2 | 1 |
| K | power of the steady path over that of all scattered ones; 0: Rayleigh | 1 |

Shadowing is sigma S(t) with S(t) = sum_n g(t/h - n) Z_n / sqrt(sum_n g(t/h - n)^2), h = tau/2 and g(u) = exp(-u^2/2):
a stationary Gaussian process with variance 1 and correlation exp(-(lag/tau)^2). The fast gain of a packet is
|sqrt(K/(K+1)) + (X + iY)/sqrt(2(K+1))|^2 with normal X and Y, whose mean is 1.
"""

from __future__ import annotations

from math import comb, exp, fsum, log10, pow, sqrt
from typing import NamedTuple

from netem.draws import normal

# Information weights B_d of the code (561, 753), from its free distance 12 on, in steps of 2.
_WEIGHTS = (33, 281, 2179, 15035, 105166, 692330, 4580007, 29692894)
_FREE_DISTANCE = 12

PH = 8.0  # assumption: from 7.9 to 8.2, absorption changes by -2 to 5 % at 10 kHz and by 1 % at 25 kHz


class SeaWater(NamedTuple):
    """The properties of sea water that its speed of sound and its absorption depend on."""

    temperature: float  # deg C
    salinity: float  # ppt
    depth: float  # m


def sound_speed(water: SeaWater) -> float:
    """Speed of sound in sea water, by Mackenzie.

    Args:
        water: its temperature, salinity and depth.

    Returns:
        The speed [m/s].
    """
    T, S, D = water.temperature, water.salinity - 35.0, water.depth
    c = 1448.96 + 4.591 * T - 5.304e-2 * T * T + 2.374e-4 * T * T * T
    return c + 1.340 * S + 1.630e-2 * D + 1.675e-7 * D * D - 1.025e-2 * T * S - 7.139e-13 * T * D * D * D


def absorption(f_khz: float, water: SeaWater | None = None) -> float:
    """Absorption, by Francois and Garrison; by Thorp if nothing is known of the water.

    Args:
        f_khz: frequency [kHz].
        water: None: 4 deg C, as Thorp had it.

    Returns:
        The absorption [dB/km].
    """
    f2 = f_khz * f_khz
    if water is None:
        if f_khz < 0.4:
            return 0.002 + 0.11 * f2 / (1.0 + f2) + 0.011 * f2
        return 0.11 * f2 / (1.0 + f2) + 44.0 * f2 / (4100.0 + f2) + 2.75e-4 * f2 + 0.003
    T, S, D = water
    c = 1412.0 + 3.21 * T + 1.19 * S + 0.0167 * D
    f_boric = 2.8 * sqrt(S / 35.0) * pow(10.0, 4.0 - 1245.0 / (T + 273.0))
    boric = 8.86 / c * pow(10.0, 0.78 * PH - 5.0) * f_boric * f2 / (f_boric * f_boric + f2)
    f_sulphate = 8.17 * pow(10.0, 8.0 - 1990.0 / (T + 273.0)) / (1.0 + 0.0018 * (S - 35.0))
    sulphate = 21.44 * S / c * (1.0 + 0.025 * T) * f_sulphate * f2 / (f_sulphate * f_sulphate + f2)
    if T <= 20.0:
        viscous = 4.937e-4 - 2.59e-5 * T + 9.11e-7 * T * T - 1.50e-8 * T * T * T
    else:
        viscous = 3.964e-4 - 1.146e-5 * T + 1.45e-7 * T * T - 6.5e-10 * T * T * T
    deep_sulphate, deep_water = 1.0 - 1.37e-4 * D + 6.2e-9 * D * D, 1.0 - 3.83e-5 * D + 4.9e-10 * D * D
    return boric + sulphate * deep_sulphate + viscous * f2 * deep_water


def transmission_loss(range_m: float, f_khz: float, spreading: float, water: SeaWater | None = None) -> float:
    """Transmission loss: spreading and absorption.

    Args:
        range_m: distance [m]; within 1 m nothing is lost.
        f_khz: frequency [kHz].
        spreading: 1 cylindrical, 1.5 practical, 2 spherical [1].
        water: as for `absorption`.

    Returns:
        The loss [dB].
    """
    if range_m <= 1.0:
        return 0.0
    return 10.0 * spreading * log10(range_m) + absorption(f_khz, water) * range_m / 1000.0


def noise_density(f_khz: float, shipping: float, wind_mps: float) -> float:
    """Ambient noise of turbulence, shipping, wind and heat; the parts add as powers.

    Args:
        f_khz: frequency [kHz].
        shipping: activity, from 0 (none) to 1 (heavy).
        wind_mps: speed of the wind [m/s].

    Returns:
        The power spectral density [dB re 1 uPa/sqrt(Hz)].
    """
    log_f = log10(f_khz)
    parts = (
        17.0 - 30.0 * log_f,
        40.0 + 20.0 * (shipping - 0.5) + 26.0 * log_f - 60.0 * log10(f_khz + 0.03),
        50.0 + 7.5 * sqrt(wind_mps) + 20.0 * log_f - 40.0 * log10(f_khz + 0.4),
        -15.0 + 20.0 * log_f,
    )
    return decibels(fsum(power(part) for part in parts))


def noise_level(f_khz: float, bandwidth_hz: float, shipping: float, wind_mps: float) -> float:
    """Noise within a bandwidth, whose density is taken as that at its middle.

    Args:
        f_khz: middle of the band [kHz].
        bandwidth_hz: its width [Hz].
        shipping: as for `noise_density`.
        wind_mps: likewise.

    Returns:
        The level [dB re 1 uPa].
    """
    return noise_density(f_khz, shipping, wind_mps) + 10.0 * log10(bandwidth_hz)


def bit_error_rate(snr_db: float) -> float:
    """Bit errors after decoding, of coded non-coherent FSK in Rayleigh fading.

    Args:
        snr_db: signal-to-noise ratio [dB].

    Returns:
        The share of wrong bits [1]: a bound, so it may exceed 1.
    """
    p = 1.0 / (2.0 + power(snr_db))
    total = 0.0
    for index, weight in enumerate(_WEIGHTS):
        d = _FREE_DISTANCE + 2 * index
        total += weight * p**d * fsum(comb(d - 1 + k, k) * (1.0 - p) ** k for k in range(d))
    return total


def packet_error_rate(snr_db: float, bits: int, lost_below_db: float, clear_above_db: float) -> float:
    """The probability that a packet cannot be decoded.

    Args:
        snr_db: signal-to-noise ratio [dB].
        bits: length of the packet [bit].
        lost_below_db: at or below this ratio [dB] every packet is lost.
        clear_above_db: at or above this ratio [dB] no packet is lost. If both ratios are equal, packets at that ratio
            are received.

    Returns:
        The probability [1].
    """
    if snr_db >= clear_above_db:
        return 0.0
    if snr_db <= lost_below_db:
        return 1.0
    return 1.0 - (1.0 - min(1.0, bit_error_rate(snr_db))) ** bits


def power(level_db: float) -> float:
    """The ratio of powers that a level is."""
    return float(10.0 ** (level_db / 10.0))


def decibels(ratio: float) -> float:
    return 10.0 * log10(ratio)


SHADOWING, SCATTER = "shadowing", "scatter"  # purposes of draws
_REACH = 5  # g is 4e-6 beyond it
_LEAST = 1e-30  # a power that is lost for sure


def fading_gain_db(seed: int, src: int, dst: int, at_ns: int, sigma: float, tau_ns: int, k: float | None) -> float:
    """Fading of one transmission.

    Args:
        seed: of the run.
        src: number of the sender.
        dst: number of the receiver.
        at_ns: when the transmission begins [ns].
        sigma: standard deviation of the shadowing [dB].
        tau_ns: after which its correlation is 1/e [ns]; 0: the shadowing never changes.
        k: power of the steady path over the scattered ones [1]; None: there is no fast fading.

    Returns:
        The gain that adds to the level [dB].
    """
    gain = sigma * _shadowing(seed, src, dst, at_ns, tau_ns) if sigma else 0.0
    return gain if k is None else gain + decibels(max(_LEAST, _scatter(seed, src, dst, at_ns, k)))


def _shadowing(seed: int, src: int, dst: int, at_ns: int, tau_ns: int) -> float:
    if not tau_ns:  # the shadowing never changes
        return normal(seed, SHADOWING, src, dst, 0)
    place = at_ns / (tau_ns / 2.0)
    total = power = 0.0
    for n in range(int(place) - _REACH, int(place) + _REACH + 2):
        weight = exp(-0.5 * (place - n) * (place - n))
        total += weight * normal(seed, SHADOWING, src, dst, n)
        power += weight * weight
    return total / sqrt(power)


def _scatter(seed: int, src: int, dst: int, at_ns: int, k: float) -> float:
    spread = sqrt(0.5 / (k + 1.0))
    x = sqrt(k / (k + 1.0)) + spread * normal(seed, SCATTER, src, dst, at_ns, 0)
    y = spread * normal(seed, SCATTER, src, dst, at_ns, 1)
    return x * x + y * y
