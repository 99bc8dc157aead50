"""How many samples a statistical law is tested with: a quarter in the quick tests, all with `-m ''`.

A bound that is stated in standard errors is as strict with fewer samples: it allows what chance does to them, so the
quick tests notice a mistake of twice the size. The draws are the same in each run, so neither set fails by bad luck.
"""

from __future__ import annotations

QUICK = 4
_divisor = [1]


def take_all(every: bool) -> None:
    """Choose the size of all samples. `conftest.py` calls it once, when pytest begins."""
    _divisor[0] = 1 if every else QUICK


def samples(count: int) -> int:
    """The number to take where `count` are wanted."""
    return max(1, count // _divisor[0])
