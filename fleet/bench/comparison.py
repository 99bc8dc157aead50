"""The changes between two measurements that are larger than their noise: slower or faster.

A figure is compared as its ratio to the baseline of the same minute, where it has one, since the machine itself may
have become slower. It changed if two conditions hold. The repeats of the two measurements do not overlap: the worst of
one is better than the best of the other. And the medians are further apart than the repeats of either measurement, and
than `LEAST`. With five repeats each, chance alone separates two equal figures once in 126 times; the two other
conditions keep small and large drifts of the machine out.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median

import msgspec

from fleet.bench.figures import FORMAT, Change, Figure, FiguresComparison, Measured
from fleet.errors import FleetError
from netem.private_file import read_file

LEAST = 0.10  # a smaller change counts as noise, however well the repeats agree
FEWEST = 3  # repeats, or the noise is not known
BUSY = 0.5  # load per processor before a measurement from which on it says so
MOST_BYTES = 10_000_000


class _Format(msgspec.Struct):
    format: int


def _unusable(path: Path, reason: str) -> FleetError:
    """The error about a file that is not what `fleet bench -o` writes."""
    return FleetError(f"{path}: {reason}")


def read(path: Path) -> Measured:
    """The document that `fleet bench -o` wrote.

    Raises:
        FleetError: it cannot be read, or is something else.
    """
    try:
        text = read_file(path, MOST_BYTES)
    except OSError as error:
        raise _unusable(path, f"expected the file that fleet bench -o wrote: {error.strerror or error}") from error
    try:
        found = msgspec.json.decode(text, type=_Format).format
        if found != FORMAT:
            raise _unusable(path, f"expected format {FORMAT}, got {found}: another version wrote it; measure again")
        measured = msgspec.json.decode(text, type=Measured)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _unusable(path, f"not the figures of fleet bench: {str(error)[:200]}") from error
    for figure in measured.figures:
        if figure.ratios and len(figure.ratios) != len(figure.samples):
            counts = f"{len(figure.samples)} samples and {len(figure.ratios)} ratios"
            raise _unusable(path, f"expected a ratio for each sample, got {counts} of {figure.name[:80]!r}")
        if not all(0 < value < float("inf") for value in (*figure.samples, *figure.ratios)):
            raise _unusable(path, f"expected positive numbers, got others in {figure.name[:80]!r}")
    return measured


def compare(old: Measured, new: Measured, path: Path) -> FiguresComparison:
    """Compare all figures that both have.

    Args:
        path: where the old ones come from.

    Raises:
        FleetError: they have no figure in common.
    """
    before = {figure.name: figure for figure in old.figures}
    now = {figure.name: figure for figure in new.figures}
    common = [name for name in now if name in before and _alike(before[name], now[name])]
    if not common:
        raise _unusable(path, "it has no figure that was measured now; measure both with the same options")
    missing = [name for name in (*before, *now) if name not in common]
    changes = [_change(before[name], now[name]) for name in common]
    of_machine = [change for change in changes if now[change.name].of_machine]
    judged = [change for change in changes if not now[change.name].of_machine]
    return FiguresComparison(str(path), _warnings(old, new, of_machine), judged, list(dict.fromkeys(missing)))


def _alike(old: Figure, new: Figure) -> bool:
    return (old.unit, old.higher_is_better, old.baseline) == (new.unit, new.higher_is_better, new.baseline)


def _change(old: Figure, new: Figure) -> Change:
    by_ratio = bool(old.ratios and new.ratios)
    before, now = (old.ratios, new.ratios) if by_ratio else (old.samples, new.samples)
    middle = median(before), median(now)
    slower = middle[0] / middle[1] if new.higher_is_better else middle[1] / middle[0]
    noise = max((max(values) - min(values)) / median(values) for values in (before, now))
    verdict = "same"
    apart = min(before) > max(now) or max(before) < min(now)
    if apart and max(slower, 1 / slower) > 1 + max(LEAST, noise) and min(len(before), len(now)) >= FEWEST:
        verdict = "slower" if slower > 1 else "faster"
    return Change(new.name, "ratio" if by_ratio else "value", *middle, slower, noise, verdict)


def _warnings(old: Measured, new: Measured, of_machine: Sequence[Change]) -> list[str]:
    """Why the two may not be comparable."""
    pairs = [
        ("processors", old.machine.cpus, new.machine.cpus),
        ("processor", old.machine.processor, new.machine.processor),
        ("system", old.machine.system, new.machine.system),
        ("Python", old.machine.python, new.machine.python),
        ("cores", old.cores, new.cores),
        ("quick", old.quick, new.quick),
        *(
            (name, old.versions.get(name, "none"), new.versions.get(name, "none"))
            for name in dict.fromkeys([*old.versions, *new.versions])
        ),
    ]
    told = [f"{what}: {before} then, {now} now" for what, before, now in pairs if before != now]
    told += [
        f"the machine itself is {change.verdict} now: {change.name} by {change.factor:.2f} x"
        for change in of_machine
        if change.verdict != "same"
    ]
    for which, measured in (("then", old), ("now", new)):
        if measured.machine.busy > BUSY:
            told.append(f"the machine was busy {which}: load {measured.machine.busy:.1f} per processor")
    fewest = min(len(figure.samples) for measured in (old, new) for figure in measured.figures)
    if fewest < FEWEST:
        told.append(f"figures with fewer than {FEWEST} repeats: their noise is not known, so they count as same")
    return told
