"""What a study is, as people write it: the keys of a study file, which are the options of `fleet sweep`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import inf
from pathlib import Path
from typing import Any

import msgspec

from fleet.quantities import time_ns
from fleet.scenario.catalogue import shipped_scenarios
from fleet.scenario.text.overrides import FAULT, NET, SET, Override
from fleet.scenario.text.plain_yaml import inline, yaml_text
from fleet.scenario.text.yaml_reader import Items, Source, plain, read
from fleet.scenario.text.yaml_reader import Mapping as Tree
from fleet.scenario.trust import TYPED, OverrideOrigin
from fleet.study.errors import StudyError
from fleet.study.plan import Plan, parse_seeds
from fleet.study.settings import MOST_SEEDS, KeepLogs, Settings
from fleet.study.values import axis, parse_axis

_NESTED = re.compile(r"\s*[\[{]")


class StudySpec(msgspec.Struct, frozen=True, omit_defaults=True):
    """The keys of a study file. Values are texts, as on the command line.

    Attributes:
        scenario: a shipped name or a file.
        title: what it asks.
        run_takes: time that one run takes a core, roughly.
        vary: VALUES by key.
        zip: whether values go together, first with first.
        seeds: how many, or which.
        draw: the seed of values that are drawn.
        set: values by key, as for `--set`.
        net, fault: as the options.
        measures: what the table shows.
        until: seeds are added to each point until this holds; empty: none is added.
        most_seeds: of a point, if seeds are added.
        keep_logs: which logs are kept: none, those of runs that failed, or all.
        timeout: wall time that one run may take; empty: any.
        budget: wall time after which no run is made any more; empty: none.
    """

    scenario: str
    title: str = ""
    run_takes: str = ""
    vary: dict[str, str] = {}
    zip: bool = False
    seeds: str = "10"
    draw: int = 1
    set: dict[str, str] = {}
    net: list[str] = []
    fault: list[str] = []
    measures: list[str] = []
    until: str = ""
    most_seeds: int = MOST_SEEDS
    keep_logs: KeepLogs = "none"
    timeout: str = ""
    budget: str = ""

    def changed(
        self,
        *,
        vary: Mapping[str, str] = {},
        set: Mapping[str, str] = {},
        net: Iterable[str] = (),
        fault: Iterable[str] = (),
        zip: bool = False,
        **given: Any,
    ) -> StudySpec:
        """The study with options added.

        A key that an option sets or varies is no longer what the file said of it; conditions of links and faults come
        behind those of the file.

        Args:
            given: other keys, in place of those of the file; None: not given.
        """
        kept = {key: text for key, text in self.vary.items() if key not in set or key in vary}
        still = {key: text for key, text in self.set.items() if key not in set and key not in vary}
        return msgspec.structs.replace(
            self,
            vary=kept | dict(vary),
            set=still | dict(set),
            net=[*self.net, *net],
            fault=[*self.fault, *fault],
            zip=self.zip or zip,
            **{key: value for key, value in given.items() if value is not None},
        )

    def plan(self, origin: OverrideOrigin = TYPED) -> Plan:
        """What it runs.

        Args:
            origin: where it comes from.

        Raises:
            StudyError: the values are none, or do not fit together.
        """
        changes = [Override(SET, f"{key}={text}") for key, text in self.set.items()]
        changes += [Override(NET, text) for text in self.net] + [Override(FAULT, text) for text in self.fault]
        axes = tuple(axis(key, text) for key, text in self.vary.items())
        return Plan(
            self.scenario, tuple(changes), axes, self.zip, parse_seeds(self.seeds), self.draw, origin, self.settings
        )

    def texts(self) -> Iterator[str]:
        """Every text in it."""
        yield from (self.scenario, self.title, self.run_takes, self.seeds, self.until, self.timeout, self.budget)
        yield from (*self.vary, *self.vary.values(), *self.set, *self.set.values())
        yield from (*self.net, *self.fault, *self.measures)

    @property
    def timeout_s(self) -> float:
        """Wall time that one run may take [s]."""
        return time_ns(self.timeout) / 1e9 if self.timeout else inf

    @property
    def budget_s(self) -> float:
        """Wall time after which no run is made any more [s]."""
        return time_ns(self.budget) / 1e9 if self.budget else inf

    @property
    def settings(self) -> Settings:
        """What it wants besides its runs."""
        return Settings(
            measures=tuple(self.measures),
            until=self.until or None,
            most_seeds=self.most_seeds,
            keep_logs=self.keep_logs,
        )

    def placed(self) -> StudySpec:
        """The same, with the whole path of the scenario's file, so that it holds in every directory."""
        if not is_file(self.scenario):
            return self
        return msgspec.structs.replace(self, scenario=str(Path(self.scenario).resolve()))

    def to_yaml(self) -> str:
        """The text of the study as a file, which may stand anywhere on this machine."""
        values = msgspec.to_builtins(self.placed())
        values["seeds"] = int(self.seeds) if self.seeds.isdecimal() else self.seeds
        if self.set:
            values["set"] = {key: _nested(text) for key, text in self.set.items()}
        for key in ("net", "fault"):
            if len(values.get(key, ())) == 1:
                (values[key],) = values[key]
        return yaml_text({"study": {key: values[key] for key in self.__struct_fields__ if key in values}})


def is_file(scenario: str, folder: Path = Path()) -> bool:
    """Whether the name of a scenario means a file in this folder rather than one that ships."""
    if scenario in shipped_scenarios():
        return False
    return bool(Path(scenario).suffix) or "/" in scenario or (folder / scenario).exists()


def set_values(texts: Iterable[str]) -> dict[str, str]:
    """The values of several `--set KEY=VALUE` by key, of a key the last.

    Raises:
        StudyError: one has no key.
    """
    values: dict[str, str] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise StudyError(f"--set {text[:80]}: expected KEY=VALUE such as 'duration=20 s'")
        values.pop(key, None)
        values[key] = value
    return values


def varied(texts: Iterable[str]) -> dict[str, str]:
    """The VALUES of several `--vary KEY=VALUES` by key.

    Raises:
        StudyError: one has no key or no values, or a key is there twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        key = parse_axis(text).key
        if key in found:
            raise StudyError(f"{key} is varied twice: give all its values at once")
        found[key] = text.partition("=")[2].strip()
    return found


def seeds_text(seeds: int | Sequence[int]) -> str:
    """The text of how many seeds there are, or which."""
    if isinstance(seeds, int):
        return str(seeds)
    return ",".join(map(str, [*seeds, *seeds[:1]]))  # one alone would be how many


def _nested(text: str) -> Any:
    """A mapping or list where the text is exactly that, so that reading the file gives the same text again."""
    if _NESTED.match(text):
        node, problems = read(Source("", text))
        if not problems and isinstance(node, Tree | Items) and inline(plain(node)) == text:
            return plain(node)
    return text
