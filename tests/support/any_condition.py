"""Link conditions of every kind, for property tests."""

from __future__ import annotations

from hypothesis import strategies as st

from netem.condition import DEFAULT_LIMIT, Condition, FourState, GilbertElliott

DAY_NS = 86_400 * 10**9
chance = st.floats(0.0, 1.0)
loss_models = st.one_of(
    st.builds(GilbertElliott, chance, chance, chance, chance),
    st.tuples(chance, chance, chance, chance, chance).map(
        lambda p: FourState(p[0], p[1], p[2] * (1.0 - p[1]), p[3], p[4] * (1.0 - p[0]))
    ),
)


@st.composite
def conditions(draw: st.DrawFn) -> Condition:
    """Every word of the grammar, in every combination that means something."""
    delay = draw(st.integers(0, DAY_NS))
    shape = draw(st.sampled_from(("uniform", "normal", "pareto", "paretonormal")))
    jitter = draw(st.integers(0, delay) if shape == "uniform" else st.integers(0, DAY_NS))
    model = draw(st.none() | loss_models)
    reorder = draw(chance) if delay else 0.0
    rate = draw(st.integers(0, 10**12))
    return Condition(
        delay_ns=delay,
        jitter_ns=jitter,
        delay_correlation=draw(chance) if jitter else 0.0,
        distribution=shape if jitter else "uniform",  # type: ignore[arg-type]
        loss=draw(chance) if model is None else 0.0,
        loss_correlation=draw(chance) if model is None else 0.0,
        loss_model=model,
        duplicate=draw(chance),
        duplicate_correlation=draw(chance),
        corrupt=draw(chance),
        corrupt_correlation=draw(chance),
        reorder=reorder,
        reorder_correlation=draw(chance) if reorder else 0.0,
        gap=draw(st.integers(1, 100)) if reorder else 0,
        rate_bit_s=rate,
        rate_overhead=draw(st.integers(0, 1500)) if rate else 0,
        limit=draw(st.sampled_from((DEFAULT_LIMIT, 1, 20))),
        seed=draw(st.none() | st.integers(0, 2**63 - 1)),
        up=draw(st.booleans()),
    )
