"""The studies that ship with the package: their names, their texts, and what `fleet list` says about them.

The list is read from the YAML alone, as that of scenarios is, because people wait for it. A test compares it with the
studies.
"""

from __future__ import annotations

from math import prod
from typing import Annotated, Any

from msgspec import Meta, Struct

from fleet.addons.studies.values import axis, values_text
from fleet.quantities import time_ns
from fleet.scenario.shipped_files import ShippedFiles
from fleet.scenario.text.yaml_reader import Source, plain, read

_FILES = ShippedFiles("fleet.addons.studies.shipped")


class ListedStudy(Struct, frozen=True):
    """One study that ships."""

    name: str
    title: str
    scenario: str
    runs: int
    core_s: Annotated[float, Meta(description="Time that all runs take one compiled core, roughly.")]


def shipped_studies() -> list[str]:
    return _FILES.names


def study_text(name: str) -> str:
    return _FILES.text(name)


def list_studies() -> list[ListedStudy]:
    return [_describe_study(name) for name in shipped_studies()]


def _describe_study(name: str) -> ListedStudy:
    root, _ = read(Source(name, study_text(name)))
    assert root is not None, name
    study: dict[str, Any] = plain(root)["study"]
    axes = [axis(key, values_text(values)) for key, values in study["vary"].items()]
    runs = prod(len(axis.values) for axis in axes) * study["seeds"]
    return ListedStudy(name, study["title"], study["scenario"], runs, runs * time_ns(study["run_takes"]) / 1e9)
