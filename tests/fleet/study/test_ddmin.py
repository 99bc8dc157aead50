"""Delta debugging: what is left fails, and nothing of it can be left out."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fleet.study.shrink import ddmin


class Asked:
    """Fails if all of some items are there; counts what it is asked."""

    def __init__(self, needed: set[int]) -> None:
        self.needed, self.count = needed, 0

    def __call__(self, parts: list[list[int]]) -> list[bool]:
        self.count += len(parts)
        return [self.needed <= set(part) for part in parts]


@given(st.integers(0, 60).flatmap(lambda n: st.tuples(st.just(n), st.sets(st.integers(0, max(0, n - 1)), max_size=6))))
def test_exactly_what_is_needed_is_left(case: tuple[int, set[int]]) -> None:
    n, needed = case
    if n == 0:
        needed = set()
    assert ddmin(range(n), Asked(needed)) == sorted(needed)


@given(st.integers(1, 40), st.integers(1, 5), st.integers(0, 999))
def test_no_item_of_the_rest_can_be_left_out(n: int, least: int, seed: int) -> None:
    """Whatever fails: here a part whose sum is large enough, or that has an odd item beside an even one."""

    def fails(parts: list[list[int]]) -> list[bool]:
        return [sum((item * seed) % 7 for item in part) >= least for part in parts]

    if not fails([list(range(n))])[0]:
        return
    left = ddmin(range(n), fails)
    assert fails([left])[0]
    assert not any(fails([left[:k] + left[k + 1 :] for k in range(len(left))]))


def test_two_of_forty_are_found_in_few_tests() -> None:
    asked = Asked({7, 31})
    assert ddmin(range(40), asked) == [7, 31]
    assert asked.count < 80
