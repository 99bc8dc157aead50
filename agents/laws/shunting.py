"""The shunting model, the bioinspired neuron that bounds and smooths an error (eqs. 43-47).

| symbol | meaning | unit | paper |
|---|---|---|---|
| x | membrane state | unit of s | (43) |
| s | input, an error held over dt | m/s or rad/s | (43) |
| a | passive decay | 1/s | Table I |
| b, b' | upper bound, minus lower bound of x (Table I prints b' as d) | unit of s | (43) |

    x' = -a x + (b - x) max(s, 0) - (b' + x) max(-s, 0)
"""

from __future__ import annotations

from math import exp


def shunting_step(x: float, s: float, a: float, b_up: float, b_down: float, dt: float) -> float:
    """The state dt [s] later with s held: the exact solution, which is stable for every dt.

    x <- x_ss + (x - x_ss) exp(-(a + |s|) dt), x_ss = b s / (a + |s|), with b' for b where s < 0. Being a
    convex combination it keeps x within [-b_down, b_up].

    Args:
        x: the state [unit of s].
        s: the input, held [m/s or rad/s].
        a: passive decay [1/s], > 0.
        b_up: b, upper bound of x [unit of s].
        b_down: b', minus the lower bound of x [unit of s].
        dt: time [s].

    Returns:
        x after dt [unit of s].
    """
    decay = a + abs(s)
    settled = (b_up if s >= 0.0 else b_down) * s / decay
    return settled + (x - settled) * exp(-decay * dt)
