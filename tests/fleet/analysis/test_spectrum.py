"""Eigenvalues of graphs: the same as of the general method, and real where they must be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fleet.analysis.stability import eigenvalues

RNG = np.random.default_rng(3)


def chain(n: int, ahead: float, behind: float) -> Any:
    A = np.diag(np.full(n - 1, ahead), -1) + np.diag(np.full(n - 1, behind), 1)
    return np.diag(A.sum(axis=1) + 1.0) - A


def ring(n: int, ahead: float, behind: float) -> Any:
    A = np.roll(np.eye(n), -1, axis=1) * ahead + np.roll(np.eye(n), 1, axis=1) * behind
    return np.diag(A.sum(axis=1) + 1.0) - A


TWO = np.kron(np.eye(2), chain(5, 1.0, 0.8))  # two graphs that are not connected


@pytest.mark.parametrize(
    ("M", "real"),
    [
        (chain(8, 1.0, 0.8), True),
        (TWO, True),
        (ring(6, 1.0, 1.0), True),
        (ring(6, 1.0, 0.8), False),  # against the cycle the weights are others
        (chain(6, 1.0, 0.0), False),  # one way only
        (np.zeros((3, 3)), True),
        (RNG.uniform(0.1, 1.0, (7, 7)), False),
    ],
)
def test_like_the_general_method(M: Any, real: bool) -> None:
    found = eigenvalues(M)
    assert np.isrealobj(found) == real or not np.iscomplexobj(np.linalg.eigvals(M))
    assert np.allclose(np.sort_complex(found), np.sort_complex(np.linalg.eigvals(M)), atol=1e-9)


def test_a_long_chain_has_no_imaginary_parts() -> None:
    """The general method gives 1,000 vehicles eigenvalues such as 4.595+0.000475i."""
    found = eigenvalues(chain(400, 1.0, 0.8))
    assert np.isrealobj(found)
    assert found.min() == pytest.approx(1.0)
    assert found.max() < 2.8 + 2.0 * np.sqrt(0.8)
