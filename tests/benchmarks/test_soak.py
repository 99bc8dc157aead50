"""The soak in small: two minutes of random faults. `benchmarks/soak.py` is the long one."""

from __future__ import annotations

import pytest
from msgspec.structs import replace
from soak import measure_soak, soak_failures, warm_and_late


@pytest.mark.slow
def test_two_minutes_of_random_faults() -> None:
    rows = measure_soak(5, 120.0, 120.0, lambda text: None)
    assert soak_failures(rows) == []
    assert [row.run for row in rows] == ["in-process", "again", "distributed"]
    assert all(row.simulated_s == 120.0 and row.restarts >= 2 for row in rows)
    # What grows with the run is what the verdicts and the log's index need; a leak of messages would be far more.
    assert all(row.warm_mb > 0 and row.end_mb < 1.5 * row.warm_mb for row in rows)

    (good, *_) = rows
    assert "ledger 1->2 off by 3" in soak_failures([replace(good, ledger="1->2 off by 3")])[0]
    assert "1 processes" in soak_failures([replace(good, orphans=1)])[0]
    assert "differ" in soak_failures([good, replace(good, digest="0")])[0]
    assert "broken" in soak_failures([replace(good, status="broken")])[0]


def test_a_long_start_is_not_taken_for_growth() -> None:
    """Memory is compared from a quarter of the run on, however long its processes took to start."""
    start = [(0.0, 1.0), (1.0, 50.0), (2.0, 90.0), (3.0, 120.0)]
    run = [(4.0 + k, 180.0) for k in range(5)]
    assert warm_and_late(start + run, 4.5) == (180.0, 180.0)
    growing = [(4.0 + k, 180.0 + 50.0 * k) for k in range(5)]
    assert warm_and_late(start + growing, 4.5) == (230.0, 380.0)
    assert warm_and_late([], 0.0) == (0.0, 0.0)
