"""The specs of studies, as people write them. Each option is declared here, once.

A field of `StudySpec` is an option of `fleet sweep`, a keyword of `fleet.sweep`, a key in the file of a study, and a
key in study.json. One of `BoundarySpec` is an option of `fleet boundary`, a keyword of `fleet.boundary`, and a key in
study.json. All of them follow from the field: from its name, its type, its default and the `Option` beside it.

`fleet.addons.studies.option_values` reads what is given for a field. This module imports little, because
`fleet sweep --help` waits for it.
"""

from __future__ import annotations

from math import inf
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from fleet.option import Kind, Option

KeepLogs = Literal["none", "failed", "all"]
MOST_ALLOWED = 1_000_000  # seeds of a point
LARGEST_SEED = 2**63 - 1


Time = Annotated[str, Kind.TIME]
Seeds = Annotated[str, Kind.SEEDS]
Values = Annotated[dict[str, str], Kind.VALUES]
Check = Annotated[
    str, Kind.CHECK, Option("The check that says whether a run passed; by default all of them do.", "NAME")
]
Set = Annotated[dict[str, str], Kind.VALUE, Option(
    "Override one scenario key in every run, e.g. network.period='200 ms'; {key} stands for what varies.")]  # fmt: skip
Net = Annotated[list[str], Kind.CONDITION, Option(
    "Impair links from the start of every run, e.g. '1->2 loss 30%'; repeatable; the last one for a link wins; "
    "{key} stands for what varies.")]  # fmt: skip
Fault = Annotated[list[str], Kind.FAULT, Option(
    "Add a fault to every run in the words of fleet inject, e.g. 'at 20s for 10s partition halves'; repeatable; "
    "{key} stands for what varies.")]  # fmt: skip
Timeout = Annotated[Time, Option("The longest wall time of one run, e.g. '5 min'.", later=True)]


class StudySpec(msgspec.Struct, frozen=True, omit_defaults=True):
    """A study of `fleet sweep`. Values are texts, as on the command line."""

    READER = "fleet.addons.studies.option_values"

    scenario: Annotated[str, Kind.SCENARIO, Option("A shipped name or a file.", flag=None)]
    title: Annotated[str, Option("What the study asks.", flag=None)] = ""
    run_takes: Annotated[Time, Option("Time that one run takes a core, roughly.", flag=None)] = ""
    vary: Annotated[Values, Option("A key and the values that it takes; repeatable.")] = {}
    zip: Annotated[
        bool, Option("Combine the values first with first; by default each with each.", keyword="zipped")
    ] = False
    seeds: Annotated[Seeds, Option("The number of runs of each point, or their seeds: 20, 5..24 or 3,7,9.")] = "10"
    draw: Annotated[int, Meta(ge=0), Option("The seed for drawn values.")] = 1
    set: Set = {}
    net: Net = []
    fault: Fault = []
    check: Check = ""
    measures: Annotated[list[str], Kind.MEASURE, Option(
        "A column of the table; repeatable. An unknown name lists all measures. Texts such as 'p95 |error.e|' "
        "measure a signal; check.NAME is the share of runs that passed a check.",
        flag="--measure", later=True)] = []  # fmt: skip
    until: Annotated[str, Kind.UNTIL, Option(
        "Add seeds to each point until its interval is this narrow, e.g. 'e_rms_m ±10 %'.")] = ""  # fmt: skip
    most_seeds: Annotated[int, Meta(ge=1, le=MOST_ALLOWED), Option(
        "The most seeds of a point, when `until` adds some.", "N")] = 1000  # fmt: skip
    keep_logs: Annotated[KeepLogs, Option(
        "Keep the logs of failed runs, or of all runs, below the study.", later=True)] = "none"  # fmt: skip
    timeout: Timeout = ""
    budget: Annotated[Time, Option(
        "Make no more runs after this wall time, e.g. '10 min'.", later=True)] = ""  # fmt: skip

    def with_options(self, **given: Any) -> StudySpec:
        """The study with options added.

        A key that an option sets or varies is no longer what the file said of it. Conditions of links and faults come
        behind those of the file, values go together if either says so, and other keys take the place of the file's.
        """
        vary, set = given.get("vary", {}), given.get("set", {})
        together = {
            "vary": {key: text for key, text in self.vary.items() if key not in set or key in vary} | vary,
            "set": {key: text for key, text in self.set.items() if key not in set and key not in vary} | set,
            "net": [*self.net, *given.get("net", ())],
            "fault": [*self.fault, *given.get("fault", ())],
            "zip": self.zip or given.get("zip", False),
        }
        return msgspec.structs.replace(self, **given | together)

    @property
    def timeout_s(self) -> float:
        """Wall time that one run may take [s]."""
        return seconds(self.timeout)

    @property
    def budget_s(self) -> float:
        """Wall time after which no run is made any more [s]."""
        return seconds(self.budget)


class BoundarySpec(msgspec.Struct, frozen=True, kw_only=True):
    """A study of `fleet boundary`: where the pass rate falls through a level."""

    READER = "fleet.addons.studies.option_values"

    along: Annotated[str, Kind.ALONG, Option("The key and the range along which to look for the border.")] = ""
    per: Annotated[Values, Option("One border for each of these values; repeatable.")] = {}
    check: Check = ""
    level: Annotated[float, Option("The pass rate at the border.", "RATE")] = 0.5
    width: Annotated[float, Option(
        "Stop when the interval of a border is this narrow, as a share of the range.", "SHARE")] = 0.1  # fmt: skip
    seeds: Annotated[Seeds, Option(
        "The most runs of a border, each with its own seed; or the seeds.")] = "60"  # fmt: skip
    set: Set = {}
    net: Net = []
    fault: Fault = []
    timeout: Timeout = ""

    @property
    def timeout_s(self) -> float:
        """Wall time that one run may take [s]."""
        return seconds(self.timeout)


Spec = type[StudySpec] | type[BoundarySpec]


def texts(spec: msgspec.Struct) -> list[str]:
    found: list[str] = []
    for value in msgspec.structs.asdict(spec).values():
        match value:
            case str():
                found.append(value)
            case list():
                found += value
            case dict():
                found += [*value, *value.values()]
    return found


def seconds(text: str) -> float:
    """A time of a spec [s]; inf: there is none."""
    from fleet.quantities import time_ns

    return time_ns(text) / 1e9 if text else inf
