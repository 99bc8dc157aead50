"""Link conditions of every kind, and links whose condition changes by itself, for property tests."""

from __future__ import annotations

from hypothesis import strategies as st

from netem.condition import DEFAULT_LIMIT, Condition, FourState, GilbertElliott
from netem.link_states import LinkStates, stationary
from netem.link_trace import LinkTrace

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
        distribution=shape if jitter else "uniform",
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


@st.composite
def link_states(draw: st.DrawFn, conditions: st.SearchStrategy[Condition]) -> LinkStates:
    """Two to four states, each of which may follow on each other."""
    count = draw(st.integers(2, 4))
    mean = tuple(draw(st.integers(10**6, 10**9)) for _ in range(count))
    following = []
    for i in range(count):
        weights = [0.0 if i == j else draw(st.floats(0.01, 1.0)) for j in range(count)]
        following.append(tuple(weight / sum(weights) for weight in weights))
    shared = draw(st.none() | st.just((0, 0, 0)))
    made = tuple(draw(conditions) for _ in range(count))
    return LinkStates(
        tuple("abcd"[:count]), made, mean, tuple(following), stationary(mean, following), shared
    )  # fmt: skip


@st.composite
def link_traces(draw: st.DrawFn, conditions: st.SearchStrategy[Condition]) -> LinkTrace:
    """A few rows, by packet or by time."""
    rows = tuple(draw(st.lists(conditions, min_size=1, max_size=5)))
    loop = draw(st.booleans())
    offset = loop and draw(st.booleans())
    if draw(st.booleans()):
        return LinkTrace(rows, loop=loop, offset=offset)
    steps = [draw(st.integers(0, 10**9)) for _ in rows]
    times = tuple(sum(steps[1 : n + 1]) for n in range(len(rows)))
    return LinkTrace(rows, times, times[-1] + 1 + steps[0], loop, offset)
