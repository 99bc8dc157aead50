"""The common part of all sections."""

from __future__ import annotations

from typing import Any, get_args

from pydantic import BaseModel, ConfigDict, model_validator


class Section(BaseModel):
    """A mapping with known keys; with nothing in it, it may also be left empty."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _empty(cls, value: Any) -> Any:
        return {} if value is None else value


def named(value: Any) -> Any:
    """A law may be given by its name alone."""
    return {"law": value} if isinstance(value, str) else value


def section_of(annotation: Any) -> type[Section] | None:
    """The section inside an annotation such as `Below | None` or `list[InitialState]`."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation
    for argument in get_args(annotation):
        section = section_of(argument)
        if section is not None:
            return section
    return None
