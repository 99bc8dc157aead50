"""What every section has in common."""

from __future__ import annotations

from typing import Any

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
