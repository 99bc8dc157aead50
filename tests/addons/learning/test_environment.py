"""A fleet as an environment of PettingZoo: its own tests, what policies see and decide, and what is refused."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
import yaml
from marks import slow
from refusals import check_refusals
from repository import ROOT
from small_scenario import small

from fleet.addons.learning.parallel_env import parallel_env
from fleet.errors import FleetError
from fleet.execution.whole_run import run as run_once

pytest.importorskip("pettingzoo", reason="the extra [rl] is not installed")
from gymnasium.utils.env_checker import data_equivalence
from notebook_pages import run_page
from pettingzoo.test import parallel_api_test
from pettingzoo.test.seed_test import parallel_seed_test

from fleet.addons.learning.environment import FleetEnv

CHECKS = {"checks": {"formation_error": {"below": "5 m", "after": "200 ms"}, "tumbled": "waived"}}
LOSSY = {**CHECKS, "network.links.*.loss": "30 %"}


def still(env: FleetEnv, message: tuple[float, ...] = (0.0,) * 6, **more: Any) -> dict[str, Any]:
    """An action for each agent."""
    return {who: {"velocity": (0.0, 0.0, 0.0), "send": 1, "message": message, **more} for who in env.agents}


KINDS: list[dict[str, Any]] = [
    {}, {"move": "force", "message": 3, "every": "30 ms"}, {"vehicles": [2]},
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_the_tests_of_pettingzoo_pass(kind: dict[str, Any]) -> None:
    parallel_api_test(parallel_env(small(), set=LOSSY, **kind), num_cycles=30)
    parallel_seed_test(lambda: parallel_env(small(), set=LOSSY, **kind), num_cycles=30)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("paper", {"duration": "12 s"}),  # with a snapshot at 10 s
        ("paper", {"duration": "3 s", "network.payload": "compact", "network.links.*.loss": "30 %"}),
        *slow(("dead-reckoning", {"duration": "3 s", "checks": {}})),
    ],
)
def test_a_policy_that_copies_the_resident_law_makes_the_same_log(name: str, changes: dict[str, Any]) -> None:
    env = parallel_env(name, set=changes, move="force", every="10 ms", resident=True, reward=lambda _: 0.0)
    _, infos = env.reset()
    while env.agents:
        *_, infos = env.step({who: infos[who]["resident"] for who in env.agents})
    whole = run_once(name, set=changes)
    assert env.result.digest == whole.digest
    assert {**env.result.values, "wall": None} == {**whole.values, "wall": None}


def test_an_agent_sees_its_belief_and_what_it_heard_and_never_the_truth() -> None:
    changes = {**CHECKS, "navigation": {"grade": "mems"}, "network.links.*.delay": "100 ms"}
    env = parallel_env(small(), set=changes, every="50 ms")
    first, infos = env.reset()
    assert infos["uuv_1"] == {"seed": 1, "asked": True}
    assert first["uuv_1"]["neighbours"]["uuv_2"]["age"] == -1.0
    assert env.run is not None
    assert list(first["uuv_1"]["eta"]) != list(env.run.state.vehicles[1].eta)
    assert "covariance" in first["uuv_1"]
    for _ in range(3):
        said = still(env)
        for k, who in enumerate(env.agents):
            said[who]["message"] = np.arange(6) + 10.0 * k
        seen, *_ = env.step(said)
        assert all(env.observation_space(who).contains(seen[who]) for who in env.agents)
    assert seen["uuv_2"]["time"] == 0.15
    heard = seen["uuv_2"]["neighbours"]
    assert set(heard) == {"uuv_1", "uuv_3"}
    assert list(heard["uuv_1"]["message"]) == [0, 1, 2, 3, 4, 5]
    assert list(heard["uuv_3"]["message"]) == [20, 21, 22, 23, 24, 25]
    assert heard["uuv_3"]["age"] == pytest.approx(0.1)


def test_who_does_not_send_is_not_heard_and_numbers_arrive_as_they_were_sent() -> None:
    env = parallel_env(small(), set=CHECKS, message=2)
    env.reset()
    actions = still(env, (0.5, 1e9))
    actions["uuv_1"]["send"] = 0
    for _ in range(3):
        seen, *_ = env.step(actions)
    assert list(seen["uuv_2"]["neighbours"]["uuv_3"]["message"]) == [0.5, 1e9]
    assert seen["uuv_2"]["neighbours"]["uuv_3"]["age"] == 0.05
    assert seen["uuv_2"]["neighbours"]["uuv_1"]["age"] == -1.0
    assert seen["uuv_3"]["neighbours"]["uuv_2"]["age"] == 0.05


def test_vehicles_without_a_policy_keep_their_laws_and_understand_states() -> None:
    env = parallel_env(small(), set=CHECKS, vehicles=[2])
    env.reset()
    assert env.agents == ["uuv_2"]
    while env.agents:
        seen, *_ = env.step(still(env, (1.0, 2.0, 3.0, 0.0, 0.0, 0.0)))
        assert set(seen) == {"uuv_2"}
    assert env.result.ledger["2->1"].delivered == 20
    assert env.result.vehicles["1"].payloads_rejected == 0


def test_the_rewards_of_an_episode_add_up_to_the_margin() -> None:
    env = parallel_env(small(), set=CHECKS)
    env.reset()
    total = 0.0
    while env.agents:
        _, rewards, terminated, truncated, _ = env.step(still(env))
        assert len(set(rewards.values())) == 1
        total += rewards["uuv_1"]
    assert (set(terminated.values()), set(truncated.values())) == ({False}, {True})
    verdict = next(one for one in env.result.checks if one.check == "formation_error")
    assert verdict.margin is not None
    assert total == pytest.approx(verdict.margin.value)


def test_a_function_of_the_state_is_the_reward_of_each() -> None:
    def far(state: Any) -> dict[str, float]:
        return {f"uuv_{i}": -one.formation_m for i, one in state.vehicles.items()}

    env = parallel_env(small(), set=CHECKS, reward=far)
    env.reset()
    _, rewards, *_ = env.step(still(env))
    assert env.run is not None
    assert rewards == {f"uuv_{i}": -one.formation_m for i, one in env.run.state.vehicles.items()}
    assert len(set(rewards.values())) == 3
    one = parallel_env(small(), set=CHECKS, reward=lambda _: {"uuv_1": 1.0})
    with pytest.raises(FleetError, match="the reward has no number for uuv_2, uuv_3"):
        one.reset()


def test_the_network_is_part_of_the_seed() -> None:
    env = parallel_env(small(), set=LOSSY)

    def episode(**seed: int) -> tuple[int, str]:
        _, infos = env.reset(**seed)
        while env.agents:
            env.step(still(env))
        return infos["uuv_1"]["seed"], env.result.digest

    first, second, third = episode(), episode(), episode()
    assert first[0] == 1
    assert len({first, second, third}) == 3
    assert [episode(seed=1), episode(), episode()] == [first, second, third]
    assert episode(seed=second[0]) == second


def test_an_agent_that_is_killed_stays_and_begins_again() -> None:
    """PettingZoo lets no agent come back, so it does not leave; its decisions count for nothing meanwhile."""
    env = parallel_env(small(), set={**CHECKS, "faults": [{"at": "200 ms", "kill": 2, "for": "300 ms"}]})
    env.reset()
    asked = []
    while env.agents:
        *_, infos = env.step(still(env))
        asked.append(infos["uuv_2"]["asked"])
    assert asked == [True] * 3 + [False] * 6 + [True] * 10 + [False]
    assert env.result.ledger["2->1"].sent == 14


def test_faults_can_be_injected_into_an_episode() -> None:
    env = parallel_env(small(), set=CHECKS)
    env.reset()
    env.step(still(env))
    assert env.run is not None
    env.run.inject("mute 3")
    while env.agents:
        env.step(still(env))
    assert env.result.ledger["3->2"].delivered == 2


HUGE = {f"vehicle.{name}": f"1e300 {unit}" for name, unit in
        (("surge_force", "N"), ("pitch_moment", "N m"), ("yaw_moment", "N m"))}  # fmt: skip


@pytest.mark.parametrize("on_death", ["continue", "abort"])
def test_an_episode_that_breaks_is_terminated(on_death: str) -> None:
    env = parallel_env(small(), set={**CHECKS, **HUGE, "on_death": on_death}, move="force")
    env.reset()
    actions = {who: {"force": (1e300, 1e300, 1e300), "send": 0, "message": np.zeros(6)} for who in env.agents}
    while env.agents:
        _, _, terminated, truncated, _ = env.step(actions)
    assert set(terminated.values()) == {on_death == "abort"}
    assert set(truncated.values()) == {on_death == "continue"}
    assert ("vehicle 1" in env.result.reason) is (on_death == "abort")


def test_a_run_whose_errors_have_no_square_has_a_result() -> None:
    """Beyond 1e154 m; it had ended with an OverflowError."""
    env = parallel_env(small(), set={**CHECKS, **HUGE}, move="force")
    env.reset()
    actions = {who: {"force": (1e300, 0.0, 0.0), "send": 0, "message": np.zeros(6)} for who in env.agents}
    while env.agents:
        env.step(actions)
    assert env.result.values["vehicles"]["1"]["e_rms_m"] is None
    assert env.result.vehicles["1"].e_final_m is not None


def test_a_wrong_action_is_refused_and_the_episode_goes_on() -> None:
    env, other = parallel_env(small(), set=CHECKS), parallel_env(small(), set=CHECKS)
    env.reset()
    others = still(env)
    check_refusals("rl/actions", lambda text: env.step({**others, "uuv_1": others["uuv_1"] | yaml.safe_load(text)}))
    with pytest.raises(FleetError, match=r"expected an action for each of uuv_1, uuv_2, uuv_3, got uuv_1$"):
        env.step({"uuv_1": still(env)["uuv_1"]})
    before, *_ = env.step(still(env))
    other.reset()
    assert data_equivalence(before, other.step(still(other))[0])


def test_what_does_not_fit_is_refused() -> None:
    def made(text: str) -> None:
        given = yaml.safe_load(text)
        parallel_env(small(), **given | {"set": CHECKS | given.get("set", {})})

    check_refusals("rl/arguments", made)


def test_an_episode_that_is_over_or_has_not_begun() -> None:
    env = parallel_env(small(), set=CHECKS)
    for early in (lambda: env.step({}), lambda: env.result):
        with pytest.raises(FleetError, match=r"call reset\(\)"):
            early()
    env.reset()
    while env.agents:
        env.step(still(env))
    with pytest.raises(FleetError, match=r"the episode is over: call reset\(\)"):
        env.step({})


def test_without_the_extra_its_name_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.logs.table.find_spec", lambda name: None)
    with pytest.raises(FleetError, match=r"parallel_env needs pettingzoo, gymnasium, which are not .*uuv-fleet\[rl\]"):
        parallel_env(small())


def test_nothing_of_pettingzoo_is_imported_by_the_rest() -> None:
    import subprocess

    code = "import fleet, sys; fleet.run, fleet.parallel_env, fleet.Run; print('pettingzoo' in sys.modules)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "False"


@pytest.mark.slow
def test_the_page_shows_what_its_code_prints(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_page(ROOT / "docs" / "guide" / "policies.md") >= 3


def test_triggers_are_refused_since_the_policies_decide_later() -> None:
    """Their moments were found in a run before, with the law of the scenario in place of the policies."""
    trigger = {"when": {"topic": "state.x", "above": "1 m"}, "for": "1 s", "fault": {"mute": 1}}
    env = parallel_env(small(), set=CHECKS | {"triggers": [trigger]})
    with pytest.raises(FleetError, match="triggers: they cannot be combined with agents that are given in Python"):
        env.reset()
