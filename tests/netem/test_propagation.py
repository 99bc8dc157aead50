"""The physics of the acoustic channel against numbers that others printed, and against its own laws."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netem import propagation as uw


def signal_to_noise(
    source_level_db: float, transmission_loss_db: float, noise_level_db: float, directivity_db: float = 0.0
) -> float:
    """The signal-to-noise ratio [dB] at the receiver."""
    return source_level_db - transmission_loss_db - (noise_level_db - directivity_db)


def test_mackenzie_at_the_published_check_points() -> None:
    """1550.744 m/s is the check value that goes with the formula; the second lies outside its range of validity."""
    assert uw.sound_speed(uw.SeaWater(25.0, 35.0, 1000.0)) == pytest.approx(1550.744, abs=5e-4)
    assert uw.sound_speed(uw.SeaWater(40.0, 40.0, 10000.0)) == pytest.approx(1718.774, abs=5e-4)


def test_thorp_at_ten_kilohertz() -> None:
    """Quoted as 1.19 dB/km, and as 5.9 dB over 5 km."""
    assert round(uw.absorption(10.0), 2) == 1.19
    assert uw.transmission_loss(5000.0, 10.0, 0.0) == pytest.approx(5.9, abs=0.05)


@pytest.mark.parametrize(
    ("f_khz", "db_per_km"),
    [
        (0.1, 0.0032),
        (0.3, 0.0121),
        (0.399, 0.0189),
        (0.4, 0.0199),
        (1.0, 0.0690),
        (10.0, 1.1870),
        (22.0, 4.8916),
        (25.0, 6.1048),
        (26.0, 6.5265),
    ],
)
def test_thorp_over_the_band(f_khz: float, db_per_km: float) -> None:
    assert uw.absorption(f_khz) == pytest.approx(db_per_km, abs=5e-5)


@pytest.mark.parametrize(
    ("f_khz", "pH", "water", "db_per_km"),
    [(50.0, 8.1, uw.SeaWater(27.0, 35.0, 10.0), 10.71), (26.0, 8.0, uw.SeaWater(10.0, 35.0, 50.0), 5.319)],
)
def test_absorption_in_known_water(
    f_khz: float, pH: float, water: uw.SeaWater, db_per_km: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first number is in the documentation of arlpy. At 26 kHz and 10 degC Thorp's is a fifth more."""
    monkeypatch.setattr(uw, "PH", pH)
    assert uw.absorption(f_khz, water) == pytest.approx(db_per_km, abs=5e-3)
    assert uw.absorption(26.0) / uw.absorption(26.0, uw.SeaWater(10.0, 35.0, 50.0)) == pytest.approx(1.227, abs=0.01)


@given(st.floats(0.2, 1000.0), st.floats(-2.0, 20.0), st.floats(0.0, 40.0), st.floats(0.0, 8000.0))
def test_absorption_grows_with_the_frequency_and_has_no_step_at_20_degrees(
    f_khz: float, temperature: float, salinity: float, depth: float
) -> None:
    """The formula for pure water has two branches."""
    water = uw.SeaWater(temperature, salinity, depth)
    assert 0.0 < uw.absorption(f_khz, water) < uw.absorption(1.01 * f_khz, water)
    below, above = (uw.absorption(f_khz, uw.SeaWater(T, salinity, depth)) for T in (20.0, 20.0001))
    assert above == pytest.approx(below, rel=2e-3)


@pytest.mark.parametrize(
    ("f_khz", "shipping", "wind", "density"),
    [
        (10.0, 0.5, 0.0, 29.355),
        (10.0, 0.5, 5.0, 46.090),
        (10.0, 0.5, 10.0, 53.036),
        (25.0, 0.5, 0.0, 22.307),
        (25.0, 0.5, 5.0, 38.548),
        (25.0, 0.5, 10.0, 45.485),
        (22.0, 0.0, 1.0, 30.400),
    ],
)
def test_noise_adds_as_power(f_khz: float, shipping: float, wind: float, density: float) -> None:
    assert uw.noise_density(f_khz, shipping, wind) == pytest.approx(density, abs=5e-4)


def test_published_sonar_equation_reproduces_within_one_percent() -> None:
    """MathWorks, `sonareqsnr`: SL 200 dB, TL 140 dB, NL 75 dB, DI 25 dB give 10 dB."""
    assert signal_to_noise(200.0, 140.0, 75.0, 25.0) == pytest.approx(10.0, rel=0.01)


def test_published_passive_sonar_figure_of_merit() -> None:
    """phonometry, section 3: SL 140, NL 60, DI 15 and a detection threshold of 8 dB allow a loss of 87 dB."""
    assert signal_to_noise(140.0, 87.0, 60.0, 15.0) == pytest.approx(8.0, rel=0.01)


@pytest.mark.parametrize(
    ("source", "range_m", "f_khz", "bandwidth", "shipping", "wind", "loss", "snr"),
    [
        (190.0, 1000.0, 22.0, 4000.0, 0.0, 1.0, 49.892, 73.688),
        (190.0, 1000.0, 25.0, 4000.0, 0.5, 5.0, 51.105, 64.327),
        (190.0, 5000.0, 25.0, 4000.0, 0.5, 5.0, 86.009, 29.423),
        (184.0, 3500.0, 26.0, 16000.0, 0.5, 5.0, 76.004, 27.735),
    ],
)
def test_whole_budgets(
    source: float, range_m: float, f_khz: float, bandwidth: float, shipping: float, wind: float, loss: float, snr: float
) -> None:
    """Computed once by hand with the same formulas and practical spreading; nobody has printed such a chain."""
    tl = uw.transmission_loss(range_m, f_khz, 1.5)
    assert tl == pytest.approx(loss, abs=1e-3)
    noise = uw.noise_level(f_khz, bandwidth, shipping, wind)
    assert signal_to_noise(source, tl, noise) == pytest.approx(snr, abs=2e-3)


def test_bit_errors_are_those_behind_ns3s_published_packet_error_rate() -> None:
    """ns-3's test of UanPhyPerUmodem: 0.539 +- 0.001 for 1000 bytes at 9 dB, one error among 288 bits allowed."""
    pb, n = uw.bit_error_rate(9.0), 8000
    assert 1.0 - (1.0 - pb) ** n - 288.0 * pb * (1.0 - pb) ** (n - 1) == pytest.approx(0.539, abs=0.001)


def test_thresholds_bound_the_packet_error_rate() -> None:
    assert uw.packet_error_rate(6.0, 120, 6.0, 10.0) == 1.0
    assert uw.packet_error_rate(10.0, 120, 6.0, 10.0) == 0.0
    assert 0.0 < uw.packet_error_rate(9.0, 120, 6.0, 10.0) < uw.packet_error_rate(8.0, 120, 6.0, 10.0) < 1.0
    assert uw.packet_error_rate(8.0, 120, 8.0, 8.0) == 0.0
    assert uw.packet_error_rate(7.99, 120, 8.0, 8.0) == 1.0


@given(st.floats(-50.0, 150.0), st.floats(0.0, 20.0), st.integers(1, 100_000))
def test_a_stronger_signal_and_a_shorter_packet_are_never_worse(snr: float, more: float, bits: int) -> None:
    worse = uw.packet_error_rate(snr, bits, -60.0, 200.0)
    assert 0.0 <= uw.packet_error_rate(snr + more, bits, -60.0, 200.0) <= worse <= 1.0
    assert worse <= uw.packet_error_rate(snr, bits + 1, -60.0, 200.0) + 1e-15


@given(st.floats(1.0, 1e5), st.floats(1.0, 2.0), st.floats(0.1, 100.0), st.floats(1.0, 2.0))
def test_loss_grows_with_range(range_m: float, factor: float, f_khz: float, spreading: float) -> None:
    near = uw.transmission_loss(range_m, f_khz, spreading)
    assert 0.0 <= near <= uw.transmission_loss(range_m * factor, f_khz, spreading)


@given(st.floats(1.0, 100.0), st.floats(0.0, 1.0), st.floats(0.0, 30.0), st.floats(0.0, 5.0))
def test_more_wind_is_never_quieter(f_khz: float, shipping: float, wind: float, more: float) -> None:
    quiet = uw.noise_density(f_khz, shipping, wind)
    assert quiet <= uw.noise_density(f_khz, shipping, wind + more)
    assert uw.decibels(uw.power(quiet)) == pytest.approx(quiet, abs=1e-9)


def test_a_sum_has_the_same_bits_in_every_python() -> None:
    """From 3.12 on `sum` rounds once, and before at each step, which gives ...9e here."""
    assert uw.bit_error_rate(7.0).hex() == "0x1.b2efedc10279fp-5"
