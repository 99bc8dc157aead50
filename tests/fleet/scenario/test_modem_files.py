"""Modem files, and the keys of a scenario's acoustic channel: what they compile to, and how mistakes are reported."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import check_refusals
from small_scenario import SMALL, read_back

from fleet.analysis import stability
from fleet.errors import ScenarioError
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.network import AcousticSection
from fleet.scenario.sections.data_files import DataFileError
from fleet.scenario.sections.modem_files import CURVES, NUMBERS, load_modem, parse_modem, shipped_modems
from fleet.scenario.sections.turns import turn_s
from netem.modem import AcousticConfig, RangingConfig

ACOUSTIC = SMALL.replace("duration: 1 s", "duration: 8 s")
ACOUSTIC = ACOUSTIC.replace("{period: 50 ms}", "{period: 2 s, payload: compact, acoustic: {modem: fsk-80}}")


def small(*overrides: str, folder: Path | None = None) -> Scenario:
    return parse_scenario(ACOUSTIC, "small.yaml", overrides, folder)


def told(*overrides: str, folder: Path | None = None) -> AcousticConfig:
    return small(*overrides, folder=folder).netem_config.acoustic


# --- files -----------------------------------------------------------------


def test_modems_ship() -> None:
    assert shipped_modems() == ["ahoi", "fsk-80", "hermes-july", "hermes-june", "mfsk-1066", "s2c", "s2c-burst"]
    assert load_modem("fsk-80").airtime_ns(15) == 2_500_000_000
    assert load_modem("s2c-burst").airtime_ns(63) == 161_000_000 + 36_258_993


def test_the_same_bytes_are_read_once_and_others_anew(tmp_path: Path) -> None:
    """A study reads its scenario for each run, and this was a third of the time."""
    assert load_modem("s2c") is load_modem("s2c")
    file = tmp_path / "mine.toml"
    text = (resources.files("netem.modems") / "fsk-80.toml").read_text("utf-8")
    file.write_text(text)
    before = load_modem(file.name, tmp_path)
    file.write_text(text.replace("value = 80,", "value = 90,", 1))
    assert (before.bit_rate, load_modem(file.name, tmp_path).bit_rate) == (80.0, 90.0)


@pytest.mark.parametrize("name", shipped_modems())
def test_every_number_says_where_it_comes_from(name: str) -> None:
    """And whoever could not read a source says that it is an assumption."""
    values = tomllib.loads((resources.files("netem.modems") / f"{name}.toml").read_text("utf-8"))
    assert values["name"] == name and values["title"]
    keys = [*NUMBERS, *CURVES]
    assert list(values["modem"]) == sorted(values["modem"], key=keys.index)
    assert all(len(entry["source"]) > 10 for entry in values["modem"].values())


@pytest.mark.parametrize("name", shipped_modems())
def test_modems_hear_each_other_within_their_range(name: str) -> None:
    """At the largest range a compact payload gets through on a calm day: the numbers belong to each other."""
    modem = load_modem(name)
    calm = AcousticConfig(modem, shipping=0.0, wind=1.0)
    if modem.delivery is not None:  # as measured: nothing at the end of the range
        assert modem.delivery.at(modem.max_range) == 0.0
        return
    assert calm.packet_error_rate(modem.max_range, 15) == 0.0
    assert calm.packet_error_rate(100 * modem.max_range, 15) == 1.0


def shipped_text(name: str = "s2c-burst") -> str:
    return (resources.files("netem.modems") / f"{name}.toml").read_text("utf-8")


def test_a_bad_modem_file_says_what_is_wrong() -> None:
    """Of the file that ships, a part of which is replaced by another."""

    def changed(old: str, new: str) -> None:
        text = shipped_text()
        assert old in text
        parse_modem(text.replace(old, new, 1).encode(), "mine.toml")

    check_refusals("scenario/modem files", changed)


@given(st.binary(max_size=200))
def test_any_bytes_are_a_modem_or_an_error(data: bytes) -> None:
    with pytest.raises(DataFileError):
        parse_modem(data, "x")


# --- keys ------------------------------------------------------------------


def test_defaults() -> None:
    acoustic = told()
    assert acoustic == AcousticConfig(load_modem("fsk-80"), backoff_ticks=acoustic.backoff_ticks)
    # 2 T (2 n - 1) with T = 2.5 s and three vehicles.
    assert acoustic.backoff_ticks == 2500
    assert small().agent_config(1).codec == "compact"
    assert small("network={}").netem_config.acoustic is None
    assert small("network={}").agent_config(1).codec == "full"
    everything = small("network=acoustic").netem_config.acoustic
    assert everything.modem == load_modem("s2c")
    assert small("network=acoustic") == small("network={acoustic: }") == small("network={acoustic: s2c}")


def test_everything_that_can_be_said() -> None:
    acoustic = told(
        "network.acoustic={modem: mfsk-1066, mac: tdma, slot: 4 s, guard: 500 ms, buffer: 2, "
        "water: {temperature: 25 degC, salinity: 35, depth: 1 km}, spreading: 2, shipping: 1, wind: 10 kn, "
        "bit_rate: 0.14 kbit/s, preamble: 20 ms, carrier: 10 kHz, bandwidth: 900 Hz, source_level: 178 dB, "
        "directivity: 3 dB, max_range: 2 km, interference_range: 3 km, mtu: 40 bytes, lost_below: 1 dB, "
        "clear_above: 2 dB, capture: 6 dB}"
    )
    assert (acoustic.mac, acoustic.slot_ticks, acoustic.guard_ns, acoustic.buffer) == ("tdma", 400, 500_000_000, 2)
    assert acoustic.sound_speed == pytest.approx(1550.744, abs=5e-4)
    assert (acoustic.spreading, acoustic.shipping, acoustic.wind) == (2.0, 1.0, 18520 / 3600)
    m = acoustic.modem
    assert (m.bit_rate, m.preamble, m.carrier, m.bandwidth) == (140.0, 0.02, 10_000.0, 900.0)
    assert (m.source_level, m.directivity, m.max_range, m.interference_range) == (178.0, 3.0, 2000.0, 3000.0)
    assert (m.mtu, m.lost_below, m.clear_above, m.capture) == (40, 1.0, 2.0, 6.0)
    assert told("network.acoustic.backoff=3 s").backoff_ticks == 300
    assert told("network.acoustic.backoff=0 s").backoff_ticks == 0
    assert told("network.acoustic.sound_speed=1480 m/s").sound_speed == 1480.0
    assert told().ranging is None
    assert told("network.acoustic.ranging=one-way") == told("network.acoustic.ranging={}")
    assert told("network.acoustic.ranging={outliers: {probability: 5 %, excess: 9 m}}").ranging == RangingConfig(
        "one-way", 0.5, 0.05, 9.0
    )
    two_way = RangingConfig("two-way", 0.1, request=2, turn_ns=3_000_000_000)
    assert (
        told("network.acoustic.ranging={method: two-way, noise: 10 cm, request: 2 bytes, turn: 3 s}").ranging == two_way
    )


def test_a_modem_file_lies_beside_the_scenario_and_is_not_needed_afterwards(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(shipped_text("fsk-80").replace("value = 80", "value = 160"))
    s = small("network.acoustic=mine.toml", folder=tmp_path)
    assert s.acoustic.modem == replace(load_modem("fsk-80"), bit_rate=160.0)
    read_back(s)
    with pytest.raises(ScenarioError, match="there is no such file"):
        small("network.acoustic=other.toml", folder=tmp_path)


CHOICES: dict[str, st.SearchStrategy[str]] = {
    "network.acoustic": st.sampled_from(
        [
            "fsk-80",
            "s2c",
            "{mac: tdma, slot: 4 s}",
            "{modem: mfsk-1066, buffer: 3}",
            "{modem: ahoi, mac: csma}",
            "{tries: 3, timeout: 2 s, acknowledgement: 1 byte}",
        ]
    ),
    "network.acoustic.modem": st.sampled_from(["fsk-80", "s2c", "mfsk-1066", "ahoi", "hermes-june", "s2c-burst"]),
    "network.acoustic.modems": st.sampled_from(["{2: s2c-burst}", "{2-3: fsk-80, 1: ahoi}"]),
    "network.acoustic.water.site": st.just("singapore-2012"),
    "network.acoustic.fading": st.sampled_from(
        ["{shadowing: 3 dB}", "{shadowing: 3 dB, correlation: 9 s, packets: rayleigh}", "{packets: rician 6 dB}"]
    ),
    "network.acoustic.ranging": st.sampled_from(["two-way", "{noise: 2 m, outliers: {probability: 3 %}}"]),
    "network.acoustic.tries": st.integers(0, 5).map(str),
    "network.acoustic.timeout": st.integers(1, 10**10).map(lambda v: f"{v} ns"),
    "network.acoustic.acknowledgement": st.integers(1, 9).map(lambda v: f"{v} bytes"),
    "network.acoustic.delivery": st.floats(0.0, 100.0).map(lambda v: f"0 m {v!r} %, 2 km 0 %"),
    "network.acoustic.captured": st.just("1 dB 0 %, 3 dB 100 %"),
    "network.acoustic.airtime": st.just("1 byte 20 ms, 64 bytes 900 ms"),
    "network.acoustic.source_level": st.floats(0.0, 300.0).map(lambda v: f"{v!r} dB"),
    "network.acoustic.carrier": st.floats(1.0, 1e7).map(lambda v: f"{v!r} Hz"),
    "network.acoustic.bit_rate": st.floats(0.1, 100.0).map(lambda v: f"{v!r} kbit/s"),
    "network.acoustic.preamble": st.integers(0, 10**9).map(lambda v: f"{v} ns"),
    "network.acoustic.mtu": st.integers(15, 100).map(lambda v: f"{v} bytes"),
    "network.acoustic.backoff": st.integers(0, 1000).map(lambda v: f"{v * 10} ms"),
    "network.acoustic.guard": st.integers(0, 10**9).map(lambda v: f"{v} ns"),
    "network.acoustic.shipping": st.floats(0.0, 1.0).map(repr),
    "network.acoustic.wind": st.floats(0.0, 50.0).map(lambda v: f"{v!r} kn"),
    "network.acoustic.water": st.floats(2.0, 30.0).map(lambda v: f"{{temperature: {v!r} degC, depth: 5 m}}"),
    "network.acoustic.sound_speed": st.floats(1400.0, 1600.0).map(lambda v: f"{v!r} m/s"),
    "network.links.*": st.just("loss 3%"),
    "network.payload": st.sampled_from(["full", "compact"]),
    "network": st.sampled_from(["ideal", "acoustic", "{payload: compact}"]),
}


@given(st.lists(st.sampled_from(sorted(CHOICES)).flatmap(lambda k: CHOICES[k].map(lambda v: f"{k}={v}")), max_size=6))
def test_every_valid_channel_round_trips(overrides: list[str]) -> None:
    try:
        s = small(*overrides)
    except ScenarioError:
        return
    read_back(s)


WILD = st.text(max_size=12) | st.sampled_from(
    ["3", "3 m", "[1]", "{}", "null", ".nan", "-1", "1e400", "true", "5 s", "1e300 dB", "1e-300 Hz", "s2c", "x.toml"]
)
KEYS = [f"network.acoustic.{key}" for key in (*AcousticSection.model_fields, "water.depth")]


@given(st.lists(st.tuples(st.sampled_from([*KEYS, "network.acoustic", "network.payload"]), WILD), max_size=4))
def test_any_override_is_accepted_or_a_scenario_error(pairs: list[tuple[str, str]]) -> None:
    """And what is accepted can be played: no number that passes overflows in the formulas."""
    try:
        s = small(*(f"{key}={value}" for key, value in pairs))
    except ScenarioError as error:
        assert str(error)  # noqa: PT017 - most are errors, all must be ours
        return
    read_back(s)
    if s.acoustic is not None:
        for range_m in (0.0, 1.0, 1e3, 1e6):
            assert 0.0 <= s.acoustic.packet_error_rate(range_m, 15) <= 1.0
            assert s.acoustic.delay_ns(range_m) >= 0


# --- what it means ---------------------------------------------------------


def test_check_says_how_often_each_talks() -> None:
    lines = "\n".join(stability.report(s := small(), stability.analyse(s)))
    assert "acoustic modem fsk-80: a compact payload has 15 bytes and takes 2.5 s of airtime; each vehicle" in lines
    assert "each vehicle sends every 15 s" in lines
    s = small("network.acoustic={modem: fsk-80, mac: tdma, slot: 4 s}")
    lines = "\n".join(stability.report(s, stability.analyse(s)))
    assert "with slots of 4 s each vehicle sends every 12 s; without loss the newest message of a neighbour" in lines
    assert "a neighbour is up to 16.5 s old" in lines


def test_check_counts_the_wait_for_news() -> None:
    """`acoustic-s2c`: T of 0.31 s and B of 2 T 7, and one s of a round at most to wait for news."""
    s = load_scenario("acoustic-s2c")
    lines = "\n".join(stability.report(s, stability.analyse(s)))
    assert "each vehicle sends every 2.753 s on average, and 46% of its transmissions overlap no other" in lines


def test_check_says_whether_noise_loses_anything() -> None:
    """In water as it is by default noise loses nothing within any shipped modem's range; with less power it does."""
    for name in ("fsk-80", "mfsk-1066", "s2c", "s2c-burst"):
        s = small(f"network.acoustic={name}", "network.payload=compact")
        assert "noise loses no packet (cause snr). At the modem's range of" in "\n".join(
            stability.report(s, stability.analyse(s))
        )
    s = small("network.acoustic={modem: mfsk-1066, source_level: 150 dB, wind: 20 m/s, shipping: 1}")
    lines = "\n".join(stability.report(s, stability.analyse(s)))
    assert "noise loses packets of 15 bytes (cause snr): 1% at 570.7 m, 50% at 685.6 m, and 0% at" in lines


def test_the_default_back_off_is_the_best_load() -> None:
    """G = n T / (T + B/2) = 1/2 for every number of vehicles, when news is always waiting."""
    for vehicles in (1, 3, 20):
        s = small(f"vehicles={vehicles}")
        airtime = s.acoustic.modem.airtime_ns(15) / 1e9
        mean, _ = turn_s(s.spec.network, s.acoustic, vehicles, s.tick_ns)
        assert vehicles * airtime / mean == pytest.approx(0.5)
