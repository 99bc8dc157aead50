"""The strips of links: shares of fates, exact where a fault begins or ends, folded where there are too many."""

from __future__ import annotations

import numpy as np
import pytest
from in_process_runs import Alone
from matplotlib.colors import to_hex

from fleet.addons.pictures.exchange import FATES
from fleet.addons.pictures.packet_shares import LATE, MOST_ROWS, ShareRow, fold, strips, time_bins, timeline
from fleet.addons.pictures.runs import LoggedRun, View, load
from netem.cause import Cause

BEGIN_S, END_S = 2.53, 3.17  # of the partition: no edge of an even bin


@pytest.fixture(scope="module")
def run(made: Alone) -> LoggedRun:
    """Links with 30 % loss and jitter, and a partition."""
    faults = f"faults=[{{at: {BEGIN_S} s, for: {END_S - BEGIN_S:.2f} s, partition: halves}}]"
    changes = ["checks={}", "duration=6 s", faults, "network.links={'*': delay 150ms 100ms loss 30%}"]
    return load([made("paper", *changes).directory])[0]


def test_shares_are_those_of_the_log(run: LoggedRun) -> None:
    """30 % loss is a third of a strip, not all of it, and a partition begins and ends at its own time."""
    (ax,) = timeline([run], View()).axes
    drawn = {str(found.get_gid()).removeprefix("fate-"): found for found in ax.collections}
    assert {Cause.DELIVERED, LATE, Cause.LOSS, Cause.PARTITION} <= drawn.keys()
    for fate, collection in drawn.items():
        expected = FATES[Cause.DELIVERED][1] if fate == Cause.DELIVERED else None
        expected = expected or FATES.get(fate, ("", "#0072B2"))[1]
        assert to_hex(collection.get_facecolor()[0]).lower() == expected.lower()
    cut = [path.vertices for path in drawn[Cause.PARTITION].get_paths()]  # one polygon per link between the halves
    x = np.concatenate([corners[:, 0] for corners in cut])
    tall = np.concatenate([_heights(corners) for corners in cut])
    assert (x[tall > 0].min(), x[tall > 0].max()) == pytest.approx((BEGIN_S, END_S))
    lost = _heights(drawn[Cause.LOSS].get_paths()[0].vertices)
    assert 0.1 < lost.mean() / 0.8 < 0.5
    told = [text.get_text() for text in ax.texts if text.get_gid() == "arrived"]
    link = run.log["link/1-2"]
    assert told[0] == f"{100.0 * (link.fate == Cause.DELIVERED).mean():.3g} %"


def _heights(corners: np.ndarray) -> np.ndarray:
    """The height of a strip's polygon at each of its corners."""
    half = len(corners[:-1]) // 2  # matplotlib closes it
    tall = np.abs(corners[:half, 1] - corners[half : 2 * half, 1][::-1])
    return np.concatenate([tall, tall[::-1], tall[:1]])


def test_bins_end_where_a_fault_begins() -> None:
    edges = time_bins(0.0, 60.0, [10.03, 30.0, 99.0], 0.1)
    assert {0.0, 10.03, 30.0, 60.0} <= set(edges.tolist())
    assert np.diff(edges).min() > 0.3
    assert len(edges) < 160


def test_polygons_of_known_bins() -> None:
    """Shares stand upon one another; a bin without packets is left out."""
    edges = np.array([0.0, 1.0, 2.0, 4.0])
    row = ShareRow("1→2", {Cause.DELIVERED: np.array([7, 1, 0]), Cause.LOSS: np.array([3, 0, 0])})
    found = strips([row], [Cause.DELIVERED, Cause.LOSS], edges)
    assert found[Cause.DELIVERED][0][:6, 0].tolist() == [0.0, 1.0, 1.0, 2.0, 2.0, 4.0]
    assert found[Cause.DELIVERED][0][6:, 1].tolist() == pytest.approx([0.4, 0.4, -0.4, -0.4, -0.16, -0.16])
    assert found[Cause.LOSS][0][6:, 1].tolist() == pytest.approx([0.4, 0.4, -0.4, -0.4, -0.4, -0.4])
    assert row.arrived == pytest.approx(8 / 11)


def test_many_links_are_folded_to_the_worst() -> None:
    rows = [ShareRow(f"{n}", {Cause.DELIVERED: np.array([100 - n]), Cause.LOSS: np.array([n])}) for n in range(80)]
    found = fold(rows)
    assert [row.name for row in found] == [*(str(n) for n in range(79, 67, -1)), "68 others"]
    assert sum(row.total for row in found) == 8000
    assert fold(rows[:MOST_ROWS]) == rows[:MOST_ROWS]
    whole = [ShareRow(f"{n}", {Cause.DELIVERED: np.array([5])}) for n in range(40)]
    assert [row.name for row in fold(whole)] == ["all 40"]


def test_only_links_between_the_vehicles_asked_for(run: LoggedRun) -> None:
    (ax,) = timeline([run], View(vehicles=(1, 2))).axes
    assert [label.get_text() for label in ax.get_yticklabels()] == ["1→2", "2→1"]
