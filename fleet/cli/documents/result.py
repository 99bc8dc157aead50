"""What `fleet run` prints with `--json`: what `result.json` holds, and where that is."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct, convert

from fleet.cli.documents.live import Formation
from fleet.execution.outcome import Result

Metres = float | None  # null: the motion left the finite numbers


class DecidingMessage(Struct):
    """The message that made the difference to a vehicle when a check failed."""

    src: Annotated[int, Meta(description="Sending vehicle.")]
    dst: Annotated[int, Meta(description="Receiving vehicle.")]
    sent_s: Annotated[float, Meta(description="When it was sent [s].")]
    at_s: Annotated[float, Meta(description="When its fate became final [s].")]
    fate: Annotated[str, Meta(description="delivered, corrupted, in flight, or the cause of its loss.")]
    heard_s: Annotated[
        float | None, Meta(description="When the newest that arrived on this link had been sent [s]; null: none has.")
    ]


class FailedMoment(Struct):
    """When a check failed, and what was so then."""

    tick: Annotated[int, Meta(description="Tick.")]
    at_s: Annotated[float, Meta(description="The same as a time [s].")]
    vehicles: Annotated[list[int], Meta(description="Vehicles that failed it; none: it is not about single ones.")]
    values: Annotated[dict[str, float | None], Meta(description="What failed it, by signal; null: not finite.")]
    faults: Annotated[list[str], Meta(description="Ids of the faults that were active.")]
    message: Annotated[DecidingMessage | None, Meta(description="The message that made the difference; null: none.")]


class CheckResult(Struct):
    """One check of the scenario."""

    check: Annotated[str, Meta(description="Its name.")]
    passed: Annotated[bool, Meta(description="Whether it passed.")]
    asked: Annotated[str, Meta(description="What was asked, in words.")]
    found: Annotated[str, Meta(description="What was found, in words.")]
    value: Annotated[float | None, Meta(description="The number that is compared; null: nothing was found.")]
    limit: Annotated[float | None, Meta(description="What it is compared with; null: it is only reported.")]
    unit: Annotated[str, Meta(description="Unit of both.")]
    moment: Annotated[
        FailedMoment | None, Meta(description="Of one of your own checks, when it failed; null: it did not.")
    ] = None
    signals: Annotated[list[str], Meta(description="Of one of your own checks, the signals that it looked at.")] = []


class SignalValue(Struct):
    """What an agent reported last."""

    value: Annotated[float | None, Meta(description="The value; null: it is not finite.")]
    unit: Annotated[str, Meta(description="Its unit; 1: none.")]


class VehicleResult(Struct):
    """What one vehicle came to."""

    settle_10pct_s: Annotated[
        float | None,
        Meta(description="How long after its start e stays below 10 % of its first value [s]; null: not settled."),
    ]
    settle_5cm_s: Annotated[float | None, Meta(description="From when on e stays below 5 cm [s]; null: not settled.")]
    e_rms_m: Annotated[Metres, Meta(description="Root mean square of e over the last 10 s [m].")]
    e_final_m: Annotated[Metres, Meta(description="Consensus error e at the end [m].")]
    formation_final_m: Annotated[Metres, Meta(description="Formation error at the end [m].")]
    effort_Ns: Annotated[float | None, Meta(description="Integral of the magnitude of the surge force [N s].")]
    u_cmd_max_mps: Annotated[float | None, Meta(description="Greatest commanded speed [m/s]; null: not reported.")]
    qp_failures: Annotated[int, Meta(description="How often the optimisation of the gain failed.")]
    payloads_rejected: Annotated[int, Meta(description="Damaged payloads that the agent refused.")]
    agent: Annotated[str, Meta(description="The whole agent that it runs; empty: the laws of a controller.")]
    signals: Annotated[
        dict[str, SignalValue],
        Meta(description="What a whole agent reported at the end, by name; none: it reported nothing any more."),
    ]


class TumbleSpell(Struct):
    """A time in which a vehicle was tumbled."""

    vehicle: Annotated[int, Meta(description="Its number.")]
    from_s: Annotated[float, Meta(description="When it began [s].")]
    to_s: Annotated[float | None, Meta(description="When it ended [s]; null: it lasted to the end of the run.")]


class LinkAccount(Struct):
    """What became of the packets of one directed link."""

    sent: Annotated[int, Meta(description="Packets that were sent.")]
    duplicated: Annotated[int, Meta(description="Copies that the network made.")]
    delivered: Annotated[int, Meta(description="Packets and copies that were delivered.")]
    lost: Annotated[dict[str, int], Meta(description="By cause, those that were lost.")]
    in_flight: Annotated[int, Meta(description="Those that were on their way at the end.")]
    corrupted: Annotated[int, Meta(description="Those of the delivered ones that were damaged.")]


class LinkAge(Struct):
    """The age of what a link delivered last."""

    mean_s: Annotated[float, Meta(description="Mean over the ticks of the run [s].")]
    p95_s: Annotated[float, Meta(description="The least age that 95 % of the ticks did not exceed [s].")]
    max_s: Annotated[float, Meta(description="The largest [s].")]


class FaultEvent(Struct):
    """The beginning or the end of a fault, or of an event of a vehicle."""

    at_s: Annotated[float, Meta(description="When [s].")]
    fault: Annotated[str, Meta(description="Its id.")]
    action: Annotated[str, Meta(description="begins or ends.")]
    what: Annotated[str, Meta(description="What it does, as a scenario writes it.")]


class Wall(Struct):
    """Wall times."""

    in_process: Annotated[bool, Meta(description="Whether the run was one process.")]
    startup_s: Annotated[float, Meta(description="Until all processes were ready [s].")]
    run_s: Annotated[float, Meta(description="From then to the end [s].")]
    cores: Annotated[str, Meta(description="`compiled` or `plain Python`: the cores of world, agents and netem.")]
    x_real_time: Annotated[float, Meta(description="Simulated time per wall time [1].")]


class Published(Struct):
    """What became of the journal with `--publish`."""

    messages: Annotated[int, Meta(description="Messages that were published.")]
    dropped: Annotated[int, Meta(description="Messages that were dropped, since nobody took them in time.")]


class Spread(Struct):
    """The distribution of a time."""

    count: Annotated[int, Meta(description="How many were measured.")]
    negative: Annotated[int, Meta(description="How many of them are below 0.")]
    p50_ms: Annotated[float, Meta(description="Median [ms].")]
    p95_ms: Annotated[float, Meta(description="95th percentile [ms].")]
    p99_ms: Annotated[float, Meta(description="99th percentile [ms].")]
    max_ms: Annotated[float, Meta(description="The largest [ms].")]
    histogram_ms: Annotated[
        list[tuple[float, int]], Meta(description="Upper edge and count of every bucket that is not empty [ms].")
    ]


class WorldTiming(Struct):
    """How the world kept to the wall clock."""

    period_ms: Annotated[float, Meta(description="Wall time of a tick [ms].")]
    run_s: Annotated[float, Meta(description="Wall time of the ticks that began [s].")]
    held_s: Annotated[float, Meta(description="How long the clock stood still [s].")]
    slipped_s: Annotated[float, Meta(description="How far the world, being late, moved the clock [s].")]
    lag: Annotated[Spread, Meta(description="How late ticks began.")]
    gap: Annotated[Spread, Meta(description="From one tick to the next.")]


class VehicleTiming(Struct):
    """How one agent kept up."""

    asked: Annotated[int, Meta(description="Ticks at which it was to answer.")]
    missed: Annotated[int, Meta(description="Those that it missed.")]
    late: Annotated[int, Meta(description="Answers that came late.")]
    stale: Annotated[int, Meta(description="Ticks with a command of an earlier tick.")]
    longest: Annotated[int, Meta(description="Ticks missed in a row, at most.")]
    silent: Annotated[int, Meta(description="Ticks in which it was taken for silent.")]
    response: Annotated[Spread, Meta(description="From the measurement to its answer.")]
    gap: Annotated[Spread, Meta(description="From one measurement to the next.")]


class LinkTiming(Struct):
    """The delay of one directed link."""

    injected: Annotated[Spread, Meta(description="As the scenario asks for it.")]
    measured: Annotated[Spread, Meta(description="As it was.")]


class NetworkTiming(Struct):
    """How the network kept to the wall clock."""

    links: Annotated[dict[str, LinkTiming], Meta(description="By link, as `1->2`.")]
    hop: Annotated[Spread, Meta(description="From the network to the agent.")]
    margin: Annotated[Spread, Meta(description="From the arrival to the tick at which it is due; below 0: too late.")]
    overdue: Annotated[int, Meta(description="Deliveries that were used after the tick at which they were due.")]
    unread: Annotated[int, Meta(description="Deliveries that no agent had confirmed at the end.")]
    late: Annotated[dict[str, int], Meta(description="Transmissions that came late, by vehicle.")]
    missed: Annotated[dict[str, int], Meta(description="Transmissions that did not come, by vehicle.")]


class Timing(Struct):
    """How everybody kept up with `--clock real`."""

    clock: Annotated[str, Meta(description="real.")]
    speed: Annotated[float, Meta(description="Times real time [1].")]
    label: Annotated[str, Meta(description="on time, or degraded.")]
    reasons: Annotated[list[str], Meta(description="Why it is degraded, in words.")]
    world: Annotated[WorldTiming, Meta(description="The world.")]
    vehicles: Annotated[dict[str, VehicleTiming], Meta(description="By vehicle.")]
    netem: Annotated[NetworkTiming, Meta(description="The network.")]


class Ran(Struct):
    """`fleet run --json`: what a run came to. All but the first two stand in `result.json`, too."""

    run: Annotated[str, Meta(description="Name of the run: of its directory.")]
    directory: Annotated[str, Meta(description="The run's directory.")]
    scenario: Annotated[str, Meta(description="Name of the scenario.")]
    seed: Annotated[int, Meta(description="The seed.")]
    status: Annotated[str, Meta(description="pass, check_failed, broken, interrupted or hung_up.")]
    exit: Annotated[int, Meta(description="Exit status of the command.")]
    reason: Annotated[str, Meta(description="Why it broke or was ended; empty: it came to its end.")]
    lines: Annotated[list[str], Meta(description="What explains the reason.")]
    from_s: Annotated[float, Meta(description="Time at which it began [s]; 0, or where it goes on from another.")]
    sim_s: Annotated[float, Meta(description="Time up to which it was recorded [s].")]
    checks: Annotated[list[CheckResult], Meta(description="The verdicts; none if the run did not come to its end.")]
    vehicles: Annotated[dict[str, VehicleResult], Meta(description="By vehicle.")]
    formation: Annotated[Formation, Meta(description="Formation errors at the end.")]
    tumbles: Annotated[list[TumbleSpell], Meta(description="In the order in which they began.")]
    ledger: Annotated[dict[str, LinkAccount], Meta(description="By link, as `1->2`.")]
    ages: Annotated[dict[str, LinkAge], Meta(description="By link, and of all links as `*`.")]
    middleware_lost: Annotated[int, Meta(description="Messages that zenoh lost; such a run is invalid.")]
    faults: Annotated[list[FaultEvent], Meta(description="Faults, in the order of time.")]
    events: Annotated[list[FaultEvent], Meta(description="When vehicles were tumbled or diverged, in that order.")]
    messages: Annotated[int, Meta(description="Messages of the log; with `log: none` those it would have.")]
    log_bytes: Annotated[int, Meta(description="Size of the log [bytes]; 0: there is none.")]
    digest: Annotated[str, Meta(description="SHA-256 of these messages, in hexadecimal.")]
    python: Annotated[str, Meta(description="Version of Python.")]
    wall: Annotated[Wall, Meta(description="Wall times.")]
    rejected: Annotated[dict[str, int], Meta(description="Messages that were refused, by key.")]
    deaths: Annotated[
        dict[str, list[str]],
        Meta(description="By vehicle, how its agents ended that no fault killed, one after the other."),
    ]
    notes: Annotated[list[str], Meta(description="What processes and agents told the operator.")]
    published: Annotated[Published | None, Meta(description="With `--publish`; else null.")] = None
    timing: Annotated[Timing | None, Meta(description="With `--clock real`; else null.")] = None


def ran(result: Result) -> Ran:
    """The document of a run."""
    assert result.directory is not None  # of a run that the command line made
    return convert({"run": result.directory.name, "directory": str(result.directory), **result.values}, Ran)
