"""What depends on the seed: `fleet check` says so if, and only if, runs with two seeds differ."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from small_scenario import small

import netem.draws
from fleet.analysis import seed as analysis
from fleet.analysis.seed import PERHAPS, declared, seeded
from fleet.execution.stepped_run import run
from fleet.scenario.catalogue import shipped_scenarios
from fleet.scenario.loading import changed, load_scenario
from fleet.scenario.scenario import Scenario

ROOT = Path(netem.draws.__file__).parent.parent
SEEDS = range(1, 9)  # a draw among two things is the same for all of them in one case of 128
FEW = range(1, 4)  # where nothing may differ


def check(scenario: Scenario) -> None:
    said = seeded(scenario)
    first, *others = SEEDS if said else FEW
    digest = run(scenario, seed=first).digest
    assert bool(said) == any(run(scenario, seed=seed).digest != digest for seed in others), said


_NONE = {
    "m": ("depth_bias", "depth_noise", "start"), "m/s": ("dvl_noise",), "%": ("dvl_scale",),
    "deg": ("heading_bias", "heading_noise", "tilt"), "deg/h": ("gyro_bias",),
    "deg/sqrt(h)": ("heading_walk", "gyro_walk"),
}  # fmt: skip
GRADE = "{" + ", ".join(f"{key}: 0 {unit}" for unit, keys in _NONE.items() for key in keys)  # without an error
NEMESIS = "{{every: 200 ms, for: 100 ms, pick: [{}]}}"
PARTS: dict[str, list[str]] = {
    "initial": ["{scatter: 0 m}", "{scatter: 1 m}"],
    "graph": ["{shape: path}", "{shape: random, probability: 100 %}", "{shape: random, probability: 50 %}"],
    "network.links": [
        "{}", "{'*': loss 0%}", "{'*': loss 100%}", "{'*': loss 40%}", "{'*': loss 40% seed 7}", "{'1->2': loss 40%}",
        "{'*': delay 100ms 40ms}", "{'*': duplicate 100%}", "{'*': duplicate 50% 20%}", "{'*': corrupt 100%}",
        "{'*': loss 40% down}", "{'*': loss gemodel 50% 50%}", "{'*': loss gemodel 0% 50%}",
        "{'*': loss state 40% 40%}", "{'*': loss state 0% 40%}", "{'*': delay 100ms reorder 50%}",
        "{'*': delay 100ms reorder 100%}",
    ],
    "sensors.position_noise": ["0 m", "1 cm"],
    "navigation": [
        "ideal", "tactical", GRADE + "}", GRADE + ", gps: {depth: 9 m}}", GRADE + ", gps: {depth: 9 m, noise: 0 m}}",
        GRADE.replace("dvl_noise: 0", "dvl_noise: 1") + "}", GRADE.replace("start: 0", "start: 1") + "}",
    ],
    "sea.current": ["0 0 0 m/s", "{sigma: 5 5 0 cm/s}"],
    "faults": [
        "[]", "[{at: 200 ms, dropout: {probability: 100 %}}]", "[{at: 200 ms, dropout: {probability: 50 %}}]",
        "[{at: 200 ms, partition: one}]", "[{at: 200 ms, partition: ring}]", '[{at: 200 ms, partition: "1 / 2,3"}]',
        "[{at: 200 ms, noise: {position_noise: 1 cm}}]", "[{at: 900 ms, kill: 2}]",
        "[{at: 200 ms, link: {'*': loss 50%}}]", "[{at: 200 ms, current: {sigma: 1 1 0 cm/s}}]",
        "[{at: 200 ms, link: {'*': loss 50% seed 3}}]",
    ],
    "nemesis": [
        "null", NEMESIS.format("kill, down"), NEMESIS.format("mute"), NEMESIS.format("{mute: 1}"),
        NEMESIS.format("partition"), NEMESIS.format("{mute: 1}, {deaf: 2}"),
    ],
}  # fmt: skip
CALM = {key: values[0] for key, values in PARTS.items()}
ALONE = [(key, value) for key, values in PARTS.items() for value in values[1:]]
CASES = st.lists(st.sampled_from(ALONE), max_size=3)


def changes(parts: dict[str, str]) -> list[str]:
    return [f"{key}={value}" for key, value in parts.items()]


@example([("nemesis", NEMESIS.format("kill, down"))])
@example([("network.links", "{'*': loss 40%}"), ("faults", "[{at: 200 ms, link: {'*': loss 50% seed 3}}]")])
@example([("network.links", "{'*': loss 40% seed 7}"), ("faults", "[{at: 200 ms, link: {'*': loss 50%}}]")])
@settings(max_examples=10)
@given(CASES)
def test_the_seed_decides_if_and_only_if_it_is_said_to(case: list[tuple[str, str]]) -> None:
    check(small(*changes(CALM | dict(case))))


@pytest.mark.parametrize(("key", "value"), [("initial", CALM["initial"]), *ALONE])
def test_each_part_alone_decides_if_and_only_if_it_is_said_to(key: str, value: str) -> None:
    check(small(*changes(CALM | {key: value})))


@pytest.mark.parametrize("name", shipped_scenarios())
def test_of_shipped_scenarios_it_is_true(name: str) -> None:
    """In their first second, and without faults that come later."""
    scenario = load_scenario(name, ["duration=1 s", "checks={}"])
    said = seeded(scenario)
    if not said or not said[0].startswith(PERHAPS):
        assert bool(said) == (run(scenario, seed=1).digest != run(scenario, seed=2).digest), said


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("acoustic-80bps", []),
        ("acoustic-s2c", ["backoff of aloha"]),
        ("acoustic-noise", ["acoustic packet errors"]),
    ],
)
def test_an_acoustic_channel_draws_back_offs_and_packet_errors(name: str, parts: list[str]) -> None:
    scenario = load_scenario(name, ["initial.scatter=0 m", "duration=12 s", "checks={}", "log={every: 20 ticks}"])
    assert seeded(scenario) == parts
    assert (run(scenario, seed=1).digest != run(scenario, seed=2).digest) is bool(parts)


EVERYTHING = [
    "vehicles=5",
    "initial={scatter: 1 m}",
    "graph={shape: random}",
    "sensors.position_noise=1 cm",
    "navigation={grade: mems, heading_rate: 5 Hz, usbl: {at: 0 0 0 m, period: 100 ms, delay: 20 ms}}",
    "sea.current={sigma: 5 5 0 cm/s}",
    "agent.clock={drift: {sigma: 20 ppm}, offset: {sigma: 5 ms}}",
    "network.links={'*': delay 60ms 20ms 25% loss 20% 25% duplicate 20% 25% corrupt 20% 25% reorder 20% 25%, "
    "'1->2': loss gemodel 20% 50%}",
    "faults=[{at: 100 ms, dropout: {probability: 50 %}}, {at: 100 ms, noise: {position_noise: 1 cm}}, "
    "{at: 100 ms, fix: {lost: 50 %, jump: 1 m}}, {at: 100 ms, dvl: {jump: 1 m/s, chance: 100 %}}, "
    "{at: 100 ms, current: {sigma: 1 1 0 cm/s}}, {at: 100 ms, for: 100 ms, partition: ring}]",
    f"nemesis={NEMESIS.format('mute, partition')}",
]


def test_every_purpose_that_is_drawn_for_is_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    """And the other way round: a purpose that is declared is drawn for."""
    drawn: set[bytes] = set()
    hashed = netem.draws._hash

    def spied(data: bytes) -> int:
        drawn.add(data)
        return hashed(data)

    monkeypatch.setattr(netem.draws, "_hash", spied)
    noisy = load_scenario("acoustic-noise", ["duration=12 s", "checks={}", "log={every: 20 ticks}"])
    aloha = load_scenario("acoustic-s2c", ["duration=2 s", "checks={}"])
    every = small(*EVERYTHING)
    purposes = {purpose for s in (every, noisy, aloha) for found in declared(s).values() for purpose in found}
    for scenario in (every, noisy, aloha):
        run(scenario)
    # The numbers of a key stand before the purpose. A partition without a name is only tried, and so are those that
    # a nemesis could draw.
    tried = r"partition (one|majority|ring|bridge) (nemesis-\d+x*)?"
    known = "|".join([tried, *map(re.escape, sorted(purposes, key=len, reverse=True))])
    ends = re.compile(rf"(?:{known})\Z".encode())
    found = {match[0].decode() if (match := ends.search(data)) else str(data) for data in drawn}
    assert {purpose for purpose in found if not re.fullmatch(tried, purpose)} <= purposes
    assert purposes <= found


def test_what_begins_after_the_run_draws_nothing() -> None:
    late = "faults=[{at: 2 s, partition: one}, {at: 2 s, dropout: {probability: 30 %}}, {at: 2 s, link 1->2: loss 10%}]"
    assert seeded(small("initial.scatter=0 m", late)) == []


def test_every_module_that_draws_is_asked_what_it_draws() -> None:
    asked = ast.parse(Path(analysis.__file__).read_text("utf-8"))
    calls = {
        node.func.value.id
        for node in ast.walk(asked)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and isinstance(node.func.value, ast.Name)
        and node.func.attr == "draws"
    }
    drawing = set()
    for path in (path for room in ("netem", "world", "agents", "fleet") for path in (ROOT / room).rglob("*.py")):
        text = path.read_text("utf-8")
        if path.parent.name == "study" or "netem.draws" not in text:  # what a search draws is no part of a run
            continue
        for node in ast.walk(ast.parse(text)):
            names = node.names if isinstance(node, ast.ImportFrom) and node.module == "netem.draws" else []
            if {alias.name for alias in names} & {"bits", "unit", "uniform", "normal"}:
                drawing.add(path.stem)
    assert drawing == calls


def test_a_loaded_scenario_runs_the_faults_of_the_seed_that_is_asked_for() -> None:
    changes = ["duration=1 s", "checks={}", f"nemesis={NEMESIS.format('mute, deaf')}"]
    loaded = load_scenario("nemesis", changes)
    for seed in (2, 3):
        fresh = load_scenario("nemesis", [*changes, f"seed={seed}"])
        assert changed(loaded, [f"seed={seed}"]) == fresh
        assert run(loaded, seed=seed).digest == run(fresh).digest
    assert changed(changed(loaded, ["seed=2"]), ["seed=1"]) == loaded
