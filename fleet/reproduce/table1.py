"""The paper's Table I, from what our runs were given, and the parameters that it does not list."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from agents.config import AgentConfig
from fleet.reproduce.cases import CASES, NAMES, U

HEADINGS = ("parameter", *NAMES)

Value = Callable[[AgentConfig], str]


def table_1() -> list[list[str]]:
    """Its rows, in its order; what a controller does not have is N/A."""
    return _rows(
        ("K_1 [1/s]", lambda c: _diag(c.guidance.K0)),
        ("K_2 = (k_u, k_q, k_r)", lambda c: _diag((c.tracking.k_u, c.tracking.k_q, c.tracking.k_r))),
        ("Q", _optimal(lambda c: _diag(c.guidance.Q))),
        ("R_1", _optimal(lambda c: _diag(c.guidance.R1))),
        ("R_2", _optimal(lambda c: _diag(c.guidance.R2))),
        ("p_1, p_2, p_3", _optimal(lambda c: ", ".join([f"{c.guidance.p:g}"] * 3))),
        ("a [1/s]", _neurodynamic(lambda c: f"{c.tracking.a:g}")),
        ("b", _neurodynamic(lambda c: f"{c.tracking.b_up:g}")),
        ("d (b')", _neurodynamic(lambda c: f"{c.tracking.b_down:g}")),
    )


def chosen() -> list[list[str]]:
    """Values that the paper does not print and a run needs."""
    return _rows(
        ("k_theta, k_psi [1/s]", lambda c: f"{c.tracking.k_theta:g}, {c.tracking.k_psi:g}"),
        ("rho from [m/s]", _optimal(lambda c: _list(c.guidance.rho_lo))),
        ("rho to [m/s]", _optimal(lambda c: _list(c.guidance.rho_hi))),
        ("K from, to [1/s]", _optimal(lambda c: f"{c.guidance.k_min:g}, {c.guidance.k_max:g}")),
        ("optimised every, predicted [s]", _optimal(_horizon)),
        ("filter of derivatives [s]", lambda c: f"{c.tracking.tau_f:g}"),
        ("boundary layer phi", _law("tracking", "sliding-mode", lambda c: _list(c.tracking.phi))),
        ("actuators [N, N m, N m]", lambda c: _list(c.tau_max)),
    )


def _rows(*rows: tuple[str, Value]) -> list[list[str]]:
    configs = [CASES[f"{name}-{U}"].scenario().agent_config(1) for name in NAMES]
    return [[symbol, *(value(config) for config in configs)] for symbol, value in rows]


def _law(kind: str, name: str, value: Value) -> Value:
    """A parameter of one law, which the other controllers do not have."""
    return lambda config: value(config) if getattr(config, f"{kind}_law").name == name else "N/A"


def _optimal(value: Value) -> Value:
    return _law("guidance", "optimal", value)


def _neurodynamic(value: Value) -> Value:
    return _law("tracking", "neurodynamic", value)


def _horizon(config: AgentConfig) -> str:
    return f"{config.guidance.qp_ticks * config.tick_ns / 1e9:g}, {config.guidance.horizon_s:g}"


def _list(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _diag(values: Iterable[float]) -> str:
    return f"diag({_list(values)})"
