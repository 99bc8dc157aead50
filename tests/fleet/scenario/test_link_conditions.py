"""Links whose condition changes by itself: what a scenario says of them, traces in files, and mistakes in both."""

from __future__ import annotations

import csv
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from marks import slow
from refusals import check_refusals
from small_scenario import SMALL, read_back, small

from fleet.analysis.link_shares import effective_loss, link_lines
from fleet.analysis.preflight import warnings
from fleet.analysis.randomness import may_draw
from fleet.errors import ScenarioError
from fleet.scenario.loading import parse_scenario, with_overrides
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.data_files import DataFileError
from fleet.scenario.sections.trace_table import TraceRow, TraceTable, load_trace, read_csv
from netem.condition import Condition
from netem.grammar import WORDS, print_condition
from netem.limits import TRACE
from netem.link_presets import link_presets
from netem.link_trace import LinkTrace

SECOND = 10**9
STATES = (
    "network.links={'*': {states: {good: {condition: delay 50ms, mean: 8 s}, bad: {condition: loss 80%, mean: 2 s}}}}"
)
BAD = "network.links.*.states.bad"
LOG = "time [s],delivered,delay [ms],rate [kbit/s],snr [dB]\n10,1,412.5,0.08,14.2\n12.5,0,,,\n13,1,1e3,0.16,9\n"


def of(link: tuple[int, int], *overrides: str) -> Any:
    return small(*overrides).netem_config.changing[link]


def traced(folder: Path, *keys: str, text: str = LOG) -> Scenario:
    """The small scenario with a trace on 1->2."""
    (folder / "log.csv").write_text(text)
    links = f"network.links={{1->2: {{{', '.join(('trace: log.csv', *keys))}}}}}"
    return parse_scenario(SMALL, "small.yaml", [links], folder)


# --- presets ----------------------------------------------------------------


@pytest.mark.parametrize("name", link_presets())
def test_each_word_of_a_preset_has_its_source_and_the_record_has_the_words(name: str) -> None:
    preset = link_presets()[name]
    words = [word for word in preset.condition.split() if word in WORDS]
    assert words == list(preset.sources) and all(map(len, preset.sources.values()))
    assert print_condition(preset.parse()) == preset.condition
    found = small(f"network.links={{1->2: {{preset: {name}}}}}")
    assert found.conditions == {(1, 2): preset.parse()}
    assert f"1->2: {preset.condition}" in found.to_yaml()
    assert read_back(found) == found
    lossy = small(f"network.links={{1->2: {{preset: {name}}}}}", "network.links.1->2.loss=3 %")
    assert lossy.conditions[1, 2] == replace(preset.parse(), loss=0.03)


# --- states -----------------------------------------------------------------


def test_states_and_what_follows_from_them() -> None:
    """The last selector wins, as with conditions; perfect links and others stay what they are."""
    s = small(STATES, "network.links.2->3=loss 1%")
    assert set(s.netem_config.changing) == {(1, 2), (2, 1), (3, 2)}
    assert s.conditions == {(2, 3): Condition(loss=0.01)}
    states = s.netem_config.changing[1, 2]
    assert states.shares == pytest.approx((0.8, 0.2))
    assert effective_loss(states) == pytest.approx(0.16)
    assert "link states" in may_draw(s)
    (line,) = link_lines(s)
    assert line == "links *: good 80 % (mean 8 s), bad 20 % (mean 2 s) of the time; effective loss 16 %"
    assert (
        s.netem_config == small(STATES, "network.links.2->3=loss 1%", f"{BAD}.mean=2 s", f"{BAD}.loss=80%").netem_config
    )
    third = "network.links.*.states.fair={mean: 1 s, next: {bad: 100 %}}"
    assert of((1, 2), STATES, third).following == ((0, 0.5, 0.5), (0.5, 0, 0.5), (0, 1, 0))


def test_every_number_can_be_set() -> None:
    """As `--set`, and so as `--vary`: times, words of a state's condition, and whether links share their state."""
    found = of(
        (1, 2), STATES, f"{BAD}.mean=1 s", f"{BAD}.loss=50 %", f"{BAD}.rate=2kbit", "network.links.*.together=true"
    )
    assert found.mean_ns == (8 * SECOND, SECOND)
    assert found.conditions[1] == Condition(loss=0.5, rate_bit_s=2000)
    assert found.shared == (0, 0, 0)
    assert of((2, 1), "network.links={2<->1: {states: {a: {mean: 1 s}, b: {mean: 1 s}}, together: true}}").shared == (
        1,
        2,
        1,
    )


# --- traces -----------------------------------------------------------------


def test_a_trace_is_read_exactly_and_carried_along(tmp_path: Path) -> None:
    """Without its file the merged scenario is the same; what was typed is read from the file once more."""
    s = traced(tmp_path)
    trace = s.netem_config.changing[1, 2]
    rows = (Condition(412_500_000, rate_bit_s=80), Condition(loss=1.0), Condition(SECOND, rate_bit_s=160))
    assert trace == LinkTrace(rows, (0, 2_500_000_000, 3 * SECOND), 3_500_000_000)
    again = read_back(s)
    (tmp_path / "log.csv").write_text(LOG.replace("412.5", "1"))
    assert with_overrides(s, ["seed=2"]).netem_config.changing[1, 2].conditions[0].delay_ns == 1_000_000
    assert with_overrides(again, ["seed=2"]).netem_config.changing == s.netem_config.changing


@pytest.mark.parametrize(
    ("keys", "times", "period"),
    [
        (["start: 12 s"], (0, 500_000_000, SECOND), 1_500_000_000),
        (["start: 12.5 s"], (0, 500_000_000), SECOND),
        (["time_scale: 2"], (0, 5 * SECOND, 6 * SECOND), 7 * SECOND),
        (["by: packet", "start: 12 s"], (), 0),
    ],
)
def test_options_of_a_trace(keys: list[str], times: tuple[int, ...], period: int, tmp_path: Path) -> None:
    found = traced(tmp_path, *keys).netem_config.changing[1, 2]
    assert (found.times_ns, found.period_ns) == (times, period)
    assert len(found.conditions) == (len(times) or 2)


def test_a_trace_of_ratios_and_one_that_ends_early(tmp_path: Path) -> None:
    s = traced(tmp_path, "lost_below: 9 dB", text="time [s],snr [dB]\n0,9\n0.5,9.5\n")
    assert [c.loss for c in s.netem_config.changing[1, 2].conditions] == [1.0, 0.0]
    assert not any("trace" in line for line in warnings(s))
    short = traced(tmp_path, "by: packet")
    assert "the trace of 1->2 has 3 rows for 20 rounds: after its last row the link is down" in "".join(warnings(short))


def test_mistakes_in_traces(tmp_path: Path) -> None:
    check_refusals("scenario/traces of links", lambda text, *keys: traced(tmp_path, *keys, text=text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time [s]," * 1_000_000 + "\n", "line 1: expected some of the columns time, delivered, delay"),
        ("time [s],delivered\n" + "0,1\n" * (TRACE.items + 1), f"more than {TRACE.items} rows"),
        *slow(("time [s],delay [ns]\n" + "".join(f"{n},{n:09}\n" for n in range(90_000)), "900000 is the most")),
        ("x" * 10_000_001, "larger than 10 MB"),
    ],
    ids=["wide", "long", "digits", "large"],
)
def test_traces_that_are_too_large(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError) as caught:
        traced(tmp_path, text=text)
    assert words in str(caught.value)
    assert len(str(caught.value)) < 2000


def test_a_trace_that_is_not_there_or_no_file_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(DataFileError, match="there is no such file"):
        load_trace("log.csv", tmp_path)
    os.mkfifo(tmp_path / "log.csv")
    with pytest.raises(DataFileError, match="it is a pipe"):
        load_trace("log.csv", tmp_path)


CELLS = st.builds(
    TraceRow,
    st.just(0),
    st.just(True),
    st.integers(0, 86_400 * SECOND),
    st.integers(1, 10**12),
    st.floats(-1000.0, 1000.0),
)


@given(st.lists(CELLS, min_size=1, max_size=5))
def test_what_is_printed_is_read_back(rows: list[TraceRow]) -> None:
    table = TraceTable(("time", "delay", "rate", "snr"), tuple(rows))
    assert read_csv(table.text(), "t.csv") == table


ODD = st.sampled_from(["0", "1", "", "nan", "1e999", "-3", '"', "time [s]", "delay [ms]", "\x00"]) | st.text(max_size=5)


@given(st.lists(st.lists(ODD, max_size=4), max_size=5) | st.text(max_size=40))
def test_any_text_is_a_trace_or_says_why_not(text: Any) -> None:
    if not isinstance(text, str):
        text = "time [s],delivered\n" + "\n".join(map(",".join, text))
    try:
        assert read_csv(text, "t.csv").rows
    except DataFileError as error:
        assert error.problems  # noqa: PT017
    assert csv.field_size_limit() > 0
