"""What is told before a run: checks that cannot pass, faults that do nothing, logs that grow large."""

from __future__ import annotations

import pytest
from in_process_runs import Alone
from refusals import check_refusals
from small_scenario import small

from fleet.analysis.preflight import LARGE_MB, log_mb, warnings
from fleet.scenario.catalogue import list_scenarios
from fleet.scenario.loading import load_scenario


class Doubted(Exception):
    """What is told before a run, compared as refusals are."""


class NothingDoubted(Exception):
    """Nothing is told."""


def doubt(*overrides: str) -> None:
    found = warnings(small(*overrides))
    raise (Doubted if found else NothingDoubted)("\n".join(found))


def test_doubts() -> None:
    """And what is just not doubted."""
    check_refusals("analysis/warnings", doubt)


def test_nothing_is_doubted_of_what_ships() -> None:
    assert {row.name: found for row in list_scenarios() if (found := warnings(load_scenario(row.name)))} == {}


def test_the_size_of_a_log_is_foreseen(made: Alone) -> None:
    """Within a third of what it becomes, and the result says what it was."""
    for n, every in enumerate(("1 tick", "10 ticks")):
        asked = ["duration=5 s", "checks={}", f"log.every={every}"]
        scenario, result = load_scenario("rough-sea", asked), made("rough-sea", *asked)
        written = result.values["log_bytes"]
        assert written == (result.directory / "run.mcap").stat().st_size
        # The index and the topics' declarations weigh more in a short log.
        assert (
            log_mb(scenario) == pytest.approx(written / 1e6, rel=0.33 if n == 0 else 0.5) and written < LARGE_MB * 1e6
        )


def test_a_key_without_effect_is_said() -> None:
    """Scenarios of versions up to 1.0 may have it."""
    said = [text for text in warnings(small("log.snapshot=2 s")) if "log.snapshot" in text]
    assert said == ["log.snapshot has no effect: a run goes on from any moment of its log; leave it out"]
    assert not [text for text in warnings(small()) if "log.snapshot" in text]
