"""A profile with a scenario's overrides: the parameters that the controllers receive."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from agents.config import GuidanceParams, TrackingParams
from agents.profiles import profile
from fleet.schema import GuidanceSection, Section, TrackingSection

# The profiles count the QP's period in ticks of this length; a scenario with another tick keeps the period.
_PROFILE_TICK_NS = 10_000_000


def qp_period_ns(name: str, section: GuidanceSection) -> int:
    """The time between two optimisations of the gains."""
    return section.qp_period or profile(name)[0].qp_ticks * _PROFILE_TICK_NS


def guidance_params(name: str, section: GuidanceSection, tick_ns: int) -> GuidanceParams:
    """The guidance parameters of profile `name`, changed as the section says."""
    changes = _given(section)
    changes["qp_ticks"] = qp_period_ns(name, section) // tick_ns
    changes.pop("qp_period", None)
    if "horizon" in changes:
        changes["horizon_s"] = changes.pop("horizon") / 1e9
    return replace(profile(name)[0], **changes)


def tracking_params(name: str, section: TrackingSection) -> TrackingParams:
    """The tracking parameters of profile `name`, changed as the section says."""
    changes = _given(section)
    if "tau_f" in changes:
        changes["tau_f"] /= 1e9
    return replace(profile(name)[1], **changes)


def _given(section: Section) -> dict[str, Any]:
    return {key: value for key, value in section if value is not None}


def guidance_section(params: GuidanceParams, tick_ns: int) -> GuidanceSection:
    """Every parameter as a scenario would give it."""
    values = {key: getattr(params, key) for key in GuidanceSection.model_fields if hasattr(params, key)}
    return GuidanceSection.model_construct(
        **values, qp_period=params.qp_ticks * tick_ns, horizon=round(params.horizon_s * 1e9)
    )


def tracking_section(params: TrackingParams) -> TrackingSection:
    """Every parameter as a scenario would give it."""
    values = {key: getattr(params, key) for key in TrackingSection.model_fields}
    return TrackingSection.model_construct(**values | {"tau_f": round(params.tau_f * 1e9)})
