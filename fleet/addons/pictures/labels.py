"""The names of runs that are compared: what differs between them, or what the user calls them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import combinations
from pathlib import Path
from typing import Any

import yaml

from fleet.errors import FleetError, printable
from fleet.logs.open_log import Log
from fleet.logs.run_name import run_name
from netem.parsing import nearest

LONGEST = 40  # characters of a name
_MOST_KEYS = 2  # keys in a name
_MOST_TRIED = 40  # keys
_MOST_SHOWN = 28  # characters of a value
_NO_MATTER = ("title", "description", "name", "seed", "log")  # keys that change nothing of what happens
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # in C it takes a twentieth of the time


def labels_of(logs: Sequence[Log]) -> list[str]:
    """The name of each log in a legend: its scenario; of the same scenario what differs, or the seed, or else its
    directory.
    """
    names = [printable(log.run.get("scenario", "") or log.path.stem)[:LONGEST] for log in logs]
    seeds = [f"{name}, seed {log.run.get('seed', '?')}"[:LONGEST] for name, log in zip(names, logs, strict=True)]
    different = ["" for _ in logs]
    if len(set(names)) == 1 < len(logs):
        with suppress(FleetError):
            different = differences([log.scenario.to_yaml() for log in logs])
    often = Counter([*names, *filter(None, different), *seeds])
    found = [
        next((label for label in called if label and often[label] == 1), run_name(log.path))
        for *called, log in zip(names, different, seeds, logs, strict=True)
    ]
    return distinct(found)


def distinct(labels: Sequence[str]) -> list[str]:
    """The same, with numbers where several are equal."""
    seen: Counter[str] = Counter()
    found = []
    for label in labels:
        seen[label] += 1
        found.append(label if seen[label] == 1 else f"{label} ({seen[label]})")
    return found


def given_labels(paths: Sequence[Path], given: Mapping[str, str] | Sequence[str]) -> list[str | None]:
    """The name that a user gives each of some runs or studies; None: none.

    Args:
        paths: as the user wrote them.
        given: the names by path, or by the last part of a path; or names in the order of the paths.

    Raises:
        FleetError: a name is for none of them, or there are more names than paths.
    """
    if not isinstance(given, Mapping):
        if len(given) > len(paths):
            raise FleetError(f"label: expected {len(paths)} or fewer, got {len(given)}")
        return [*map(_short, given), *[None] * (len(paths) - len(given))]
    found: list[str | None] = [None for _ in paths]
    for key, label in given.items():
        places = [k for k, path in enumerate(paths) if Path(key) == path]
        places = places or [k for k, path in enumerate(paths) if key in _possible_names(path)]
        if len(places) > 1 and len(set(paths)) == len(paths):
            raise FleetError(f"label: {printable(key)!r} is {len(places)} of what is drawn; write the path as with LOG")
        if not places:
            known = list(dict.fromkeys(path.name or str(path) for path in paths))
            hint = nearest(key, known) or f"there are {', '.join(known)}"
            raise FleetError(f"label: {printable(key)!r} is none of what is drawn; {printable(hint)}")
        for place in places:
            found[place] = _short(label)
    return found


def _possible_names(path: Path) -> tuple[str, ...]:
    """What a run or a study may be called: by its directory, also where its log is named."""
    folder = path.parent if path.name == "run.mcap" else path
    return path.name, folder.name, folder.resolve().name


def _short(label: str) -> str:
    text = printable(label.strip())
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


def differences(scenarios: Sequence[str]) -> list[str]:
    """What differs between some scenarios, as few keys as tell them apart; empty texts: it is too much.

    Args:
        scenarios: merged ones, as `Scenario.to_yaml` writes them: a stranger's text could take all memory.
    """
    each = [_flat(yaml.load(text, _LOADER)) for text in scenarios]
    keys = [key for key in dict.fromkeys(key for one in each for key in one) if len({*map(_value(key), each)}) > 1]
    keys = [key for key in keys if key.partition(".")[0] not in _NO_MATTER]
    happening = [key for key in keys if not key.startswith("checks.")]
    keys = happening if _tell_apart(happening, each) else keys
    if len(keys) > _MOST_KEYS:  # one key, such as that of a law, may bring many others along
        some = (few for size in range(1, _MOST_KEYS + 1) for few in combinations(keys[:_MOST_TRIED], size))
        keys = list(next((few for few in some if _tell_apart(few, each)), ()))
    short = Counter(key.rpartition(".")[2] for key in keys)
    lists = {key for key in keys if any(isinstance(one.get(key), list) for one in each)}
    words = [", ".join(_words(key, one.get(key, [] if key in lists else None), short) for key in keys) for one in each]
    return [printable(label) for label in words] if all(len(label) <= LONGEST for label in words) else [""] * len(each)


def _tell_apart(keys: Sequence[str], each: Sequence[Mapping[str, Any]]) -> bool:
    """Whether no two of some scenarios have the same values of some keys."""
    return len({tuple(_value(key)(one) for key in keys) for one in each}) == len(each)


def _value(key: str) -> Any:
    return lambda flat: repr(flat.get(key))


def _flat(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """The keys of nested maps with dots between them."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            found |= _flat(value, f"{before}{key}.")
        else:
            found[f"{before}{key}"] = value
    return found


def _words(key: str, value: Any, short: Mapping[str, int]) -> str:
    last = key.rpartition(".")[2]
    name = last if short[last] == 1 else key
    if isinstance(value, bool):
        return name if value else f"no {name}"
    if value in ([], {}):
        return f"no {name}"
    if isinstance(value, list):
        text = yaml.safe_dump(value[0] if len(value) == 1 else value, default_flow_style=True, width=200)
        text = text.splitlines()[0].strip("{}[]").replace(": ", " ").replace("'", "")
        return text if len(text) <= _MOST_SHOWN else f"{len(value) if len(value) > 1 else 'with'} {name}"
    return f"{name} {'by default' if value is None else value}"
