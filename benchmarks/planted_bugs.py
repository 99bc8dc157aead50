"""How many runs a search needs to find a defect that was planted on purpose.

    python benchmarks/planted_bugs.py --budget 600 --seeds 10 >> planted.jsonl
    python benchmarks/planted_bugs.py --table planted.jsonl
    python benchmarks/planted_bugs.py --witnesses

Each defect is a change of a few characters in a protocol or in the agent that ships. It is made in copies of those
modules in a folder of its own; the product stays as it is. A line of JSON is written for each search, so a benchmark
that was interrupted goes on with what is missing: `--done planted.jsonl`.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

from fleet.addons.studies.engine import local_engine
from fleet.addons.studies.modules import modules_of
from fleet.addons.studies.search import search
from fleet.addons.studies.shrink import Shrinker
from fleet.execution.whole_run import run
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario, timeline_lines

SHRINK_RUNS = 150
APART = 100_000  # seeds between two searches for one defect
ELECTION, AVERAGE = "fleet.protocols.election", "fleet.protocols.average"
AUCTION, BIDDER = "fleet.protocols.bundle_auction", "fleet.protocols.bidder"
FORMATION, AGENT, NEIGHBOURS = "agents.formation_agent", "agents.agent", "agents.neighbours"
CORE = "core"  # a whole agent that is the one that ships; its text is below

_CORE = '''
from agents.api import Signal
from agents.formation_agent import FormationAgent


class Core:
    """The agent that ships."""

    signals = (Signal("neighbours_heard", "1", "neighbours heard at least once"),)

    def __init__(self, config):
        self._formation = FormationAgent(config)

    def transmit(self, nav):
        return self._formation.transmit(nav)

    def decide(self, nav, deliveries):
        tau, known = self._formation.decide(nav, deliveries)
        return tau, {"neighbours_heard": known["neighbours_heard"]}

    def state(self):
        return self._formation.state()

    def restore(self, values):
        self._formation.restore(values)
'''
# Each bench has faults that its protocol survives without a defect. Long one-way silence in an election (the vehicle
# hears who leads, and the check takes it for alone), two deaths at a time in an auction, and faults that leave no time
# to recover make the sound ones fail, too.
_EPISODES = "nemesis={mode: episodes%s}"
_GRID = "nemesis={every: %s, for: %s, until: %s, pick: [%s]}"
_COMMON = ("duration=60 s", "tick=100 ms", "log={every: 1 tick}", "faults=[]", "expect=pass")
_PLACES = "[[10, 0, 10], [20, 0, 10], [10, 12, 10], [10, -12, 10], [20, 12, 10], [20, -12, 10]]"


@dataclass(frozen=True)
class Bench:
    """What the defects of one protocol are looked for with."""

    scenario: str
    law: str  # module and class
    changes: tuple[str, ...]

    @property
    def module(self) -> str:
        return self.law.partition(":")[0]


BENCHES = {
    "election": Bench("election", f"{ELECTION}:Election", (
        *_COMMON, "moored=true", _EPISODES % ", watch: [control.leads above 0, control.candidate], pick: [%s]" % (
            "partition, kill, pause, duplicate"),
        'network.links={"*": delay 100ms 30ms loss 10%}',
        "checks={fleet.protocols.checks:AtMostOneLeader: {per: fleet}, "
        "fleet.protocols.checks:AgreeAfterHeal: {within: 6 s, quorum: fleet}}",
    )),
    "average": Bench("average", f"{AVERAGE}:ExactAverage", (
        *_COMMON, "moored=true", _EPISODES % "",
        'network.links={"*": delay 100ms 50ms loss 10% duplicate 5%}',
        "checks={fleet.protocols.checks:TrueMean: {below: 0.01, within: 10 s}}",
    )),
    "auction": Bench("auction", f"{AUCTION}:BundleAuction", (
        *_COMMON, _GRID % ("12 s", "7 s", "31 s", "kill"), "checks.tumbled=waived",
    )),
    "bids": Bench("auction", f"{AUCTION}:BundleAuction", (
        *_COMMON, "moored=true", _EPISODES % ", unit: 3 s, pick: [kill, duplicate], most_silent: 1", "vehicles=4",
        "reference={start: 0 0 10 m, velocity: 0 0 0 m/s}", "initial={scatter: 0 m, around: reference}",
        "formation={offsets: [0 6 0 m, 0 -6 0 m, 30 6 0 m, 30 -6 0 m]}",  # bids tie
        f"agent={{law: {AUCTION}:BundleAuction, parameters: {{bundle: 2, places: {_PLACES}}}}}",
        f"checks={{fleet.protocols.checks:NoConflict: {{places: {_PLACES}, bundle: 2}}}}",
    )),
    "core": Bench("leader-lost-standby", f"{CORE}:Core", (
        *_COMMON, _GRID % ("5 s", "3 s", "30 s", "down, deaf, mute, kill"),
        'network.links={"*": delay 100ms 30ms loss 10%}',
        "checks={formation_error: {below: 3 m, after: 58 s}, tumbled: waived}",
    )),
}  # fmt: skip


@dataclass(frozen=True)
class Bug:
    """A defect: in the last module of a chain that begins with the protocol's own, `old` becomes `new`."""

    name: str
    bench: str
    chain: tuple[str, ...]
    old: str
    new: str
    what: str


def _election(name: str, old: str, new: str, what: str) -> Bug:
    return Bug(name, "election", (ELECTION,), old, new, what)


def _average(name: str, old: str, new: str, what: str) -> Bug:
    return Bug(name, "average", (AVERAGE,), old, new, what)


def sound_one(bench: str) -> Bug:
    """The protocol of a bench without a defect."""
    return Bug(f"sound-{bench}", bench, (BENCHES[bench].module,), "", "", "no defect")


_TAKES_BACK = """        self._value += link.gave_value - link.took_value
        self._weight += link.gave_weight - link.took_weight
"""
_OLD_NEWS = """        if said <= self.heard.get(sender, -1):
            return
"""
BUGS = (
    _election("no-silence-after-start", "self._silent_until = tick + self._lease", "self._silent_until = tick",
              "a lease is forgotten after a restart"),
    _election("old-record", "i != self._id and (i not in self._others or values[0] > self._others[i].made)",
              "i != self._id", "an older record replaces a newer one"),
    _election("no-tie-break", "else min(fresh)", "else self._id", "without a leader each grants to itself"),
    _election("small-quorum", "2 * count > voters", "2 * (count + 1) > voters", "one vote too few makes a leader"),
    _election("grants-twice", "and (wanted == self._candidate or tick >= self._until)", "",
              "it turns to another candidate before its grant has expired"),
    _election("never-dropped", "if tick < record.made + self._lease}", "if record.made >= 0}",
              "a vehicle that is gone is never dropped"),
    _election("expired-votes", "for record in fresh.values() if tick < record.until)", "for record in fresh.values())",
              "grants count after they have expired"),
    _election("leads-too-long", "next(end for end in grants if not leads_at(end))", "max(grants)",
              "a suspended leader trusts its last grant, not its quorum"),
    _election("grant-from-now", "fresh[wanted].made + self._lease", "tick + self._lease",
              "a grant counts from when it is given, not from when the candidate was there"),
    _election("half-silence", "self._silent_until = tick + self._lease", "self._silent_until = tick + self._lease // 2",
              "after a restart it listens for half a lease"),
    _election("silence-until-heard", "        leader = self._leader(fresh, nav.tick)\n        return tau",
              "        self._silent_until = 0 if messages else self._silent_until\n"
              "        leader = self._leader(fresh, nav.tick)\n        return tau",
              "after a restart it listens until the first message"),
    _election("silence-with-a-leader", "if tick >= self._silent_until and (wanted",
              "if (tick >= self._silent_until or leader == NOBODY) and (wanted",
              "after a restart it listens only if it knows of a leader"),
    _election("until-from-now", "self._leads_until(fresh) * self._tick_s if leader",
              "(nav.tick + self._lease) * self._tick_s if leader",
              "a suspended leader trusts its lease from its last sample"),
    _election("silence-of-two-rounds", "self._silent_until = tick + self._lease", "self._silent_until = tick + 2",
              "after a restart it listens for two rounds"),
    _election("silence-for-others", "if tick >= self._silent_until and (wanted",
              "if (tick >= self._silent_until or wanted == self._id) and (wanted",
              "after a restart it grants to itself at once"),
    _election("until-last-but-one", "next(end for end in grants if not leads_at(end))", "grants[-2]",
              "a suspended leader trusts its last grant but one"),
    _election("quorum-until-all", "voters = self._vehicles if self._of_fleet else len(fresh)",
              "voters = self._vehicles if self._of_fleet and len(self._others) == self._vehicles - 1 else len(fresh)",
              "the quorum is too small until a vehicle has heard all others"),
    _election("until-of-records", "next(end for end in grants if not leads_at(end))", "max(others)",
              "a suspended leader trusts the newest record that it has"),
    _election("known-quorum", "voters = self._vehicles if self._of_fleet else len(fresh)",
              "voters = 1 + len(self._others) if self._of_fleet else len(fresh)",
              "the quorum is of the vehicles that it has heard of in this life"),
    _average("takes-nothing-back", _TAKES_BACK, "", "what was given to a vehicle that went silent is lost"),
    _average("never-forgets", "if 0 <= link.heard < nav.tick - self._forget_ticks:", "if link.heard < -1:",
             "a neighbour that is gone is never dropped"),
    _average("gives-to-the-silent", "link.heard, link.mutual = -1, False", "link.heard = -1",
             "shares go to a neighbour that is gone"),
    _average("old-round", "if delivery.sent_tick <= link.heard:", "if delivery.sent_tick < 0:",
             "an old round is accepted"),
    Bug("no-tie-break-of-bids", "bids", (AUCTION, BIDDER), "bid == other and bidder < winner", "bid == other",
        "of equal bids each believes its own"),
    Bug("double-bid", "bids", (AUCTION, BIDDER), "or not outbids(bid, self.number, self.bids[j], self.winners[j])",
        "", "it bids for what somebody else has won"),
    Bug("keeps-the-rest", "auction", (AUCTION, BIDDER), "del self.bundle[kept:]", "del self.bundle[kept : kept + 1]",
        "who is outbid keeps what it chose after that"),
    Bug("old-news", "bids", (AUCTION, BIDDER), _OLD_NEWS, "", "old news are believed"),
    Bug("never-released", "auction", (AUCTION,), "> self._silence_ticks and", "> 10**9 and",
        "the places of a vehicle that is gone stay its own"),
    Bug("neighbour-never-dropped", "core", (CORE, FORMATION, AGENT, NEIGHBOURS),
        "self._drop_after is not None and ticks > self._drop_after", "False", "a neighbour that is gone still counts"),
)  # fmt: skip

# Faults, made by hand, with which a defect fails its bench, while the sound protocol passes; none are needed for an
# empty list.
_FORGETS = (
    '{at: 20 s, for: 2 s, partition: "1,2,3 / 4,5"}',
    '{at: 22 s, for: 10 s, partition: "1,2 / 3,4,5"}',
    "{at: 22 s, for: 200 ms, kill: 3}",
)
_SUSPENDED = ('{at: 20 s, for: 12 s, partition: "1,2 / 3,4,5"}', "{at: 22500 ms, for: 6 s, pause: 1}")
WITNESSES: dict[str, tuple[str, ...]] = {
    "half-silence": _FORGETS,
    "silence-until-heard": _FORGETS,
    "silence-with-a-leader": _FORGETS,
    "until-from-now": _SUSPENDED,
    "until-of-records": _SUSPENDED,
    "silence-of-two-rounds": _FORGETS,
    "silence-for-others": _FORGETS,
    "until-last-but-one": _SUSPENDED,
    "quorum-until-all": ('{at: 44 s, kill: "1-2, 5"}', "{at: 48 s, for: 1500 ms, kill: 4}"),
    # After its restart vehicle 4 knows of 3 alone, so two are its quorum.
    "known-quorum": ('{at: 44 s, kill: "1-2, 5"}', "{at: 48 s, for: 1500 ms, kill: 4}"),
    "grant-from-now": ("{at: 20 s, for: 12 s, kill: 1}",),
    "grants-twice": ('{at: 22 s, for: 2900 ms, partition: "isolate:1"}',),
    "expired-votes": ('{at: 22 s, for: 2900 ms, partition: "isolate:1"}',),
    "old-round": ('{at: 32500 ms, for: 500 ms, duplicate: {links: "*->1", after: 2 s}}',),
    "no-tie-break-of-bids": (),
    "old-news": (
        '{at: 26100 ms, for: 4900 ms, duplicate: {links: "4->*", after: 3 s}}',
        "{at: 30600 ms, for: 100 ms, kill: 4}",
    ),
    # Vehicle 3 granted 1 its lease until 25 s, and has forgotten it. 4 and 5 have not heard 1 since 20 s, so they are
    # free at 23 s, and with 3 they are a majority.
    "no-silence-after-start": _FORGETS,
    # The grants of 3, 4 and 5 end at 23 s, that of 2 at 25 s.
    "leads-too-long": _SUSPENDED,
    "small-quorum": ('{at: 20 s, for: 12 s, partition: "1,2 / 3,4,5"}',),
    "no-tie-break": (),
    "never-dropped": ("{at: 20 s, for: 12 s, kill: 1}",),
    "old-record": ("{at: 20 s, for: 300 ms, kill: 1}",),
    "takes-nothing-back": ("{at: 20 s, for: 5 s, kill: 3}",),
    "never-forgets": ("{at: 20 s, for: 20 s, kill: 3}",),
    "gives-to-the-silent": ("{at: 20 s, for: 20 s, kill: 3}",),
    "double-bid": (),
    "keeps-the-rest": (),
    "never-released": ("{at: 10 s, kill: 3}",),
    "neighbour-never-dropped": ("{at: 45 s, for: 9 s, mute: 2}",),  # longer than `drop_after`
}


def main() -> None:
    """Search for each defect, or print the table of what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--most", type=float, default=inf, help="runs of a search")
    parser.add_argument("--budget", type=float, default=600.0, help="wall time of a search [s]")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=[], help="names of defects or protocols")
    parser.add_argument("--sound", action="store_true", help="search the protocols without any defect")
    parser.add_argument("--seeds", type=int, default=10, help="searches for each defect, with other seeds")
    parser.add_argument("--done", type=Path, help="lines of searches that need not be made again")
    parser.add_argument("--no-shrink", action="store_true")
    parser.add_argument("--witnesses", action="store_true", help="run the faults that show a defect, and no search")
    parser.add_argument("--table", type=Path, help="print the table of these lines and do nothing else")
    given = parser.parse_args()
    if given.table:
        print("\n".join(table(_lines(given.table))))
        return
    done = {(line["bug"], line["seed"]) for line in _lines(given.done)} if given.done else set()
    sound = [sound_one(name) for name in BENCHES]
    with tempfile.TemporaryDirectory() as folder:
        sys.path.insert(0, folder)
        os.chdir(folder)  # where laws are looked for
        if given.witnesses:
            print("\n".join(witness_table([bug for bug in BUGS if bug.name in WITNESSES])))
            return
        for bug in sound if given.sound else BUGS:
            if given.only and not {bug.name, bug.bench} & set(given.only):
                continue
            for number in range(given.seeds):
                seed = 1 + number * APART
                if (bug.name, seed) not in done:
                    limits = Limits(given.most, given.budget, given.workers)
                    least = SHRINK_RUNS if number == 0 and not given.no_shrink else 0
                    print(json.dumps(searched(bug, limits, seed, least)), flush=True)


class Limits(NamedTuple):
    most: float = inf  # runs of a search
    budget_s: float = inf  # of wall time
    workers: int = 1


def searched(bug: Bug, limits: Limits, seed: int = 1, least: int = 0) -> dict[str, Any]:
    """One search for a defect, which is planted in the current folder; `least`: runs for making it smaller."""
    folder = Path.cwd()
    scenario = _planted(bug, f"seed={seed}")
    modules, before = modules_of([scenario], folder), _cpu_s()
    with local_engine(limits.workers) as engine:
        found = search(scenario, engine, lambda _: None, most_runs=limits.most, budget_s=limits.budget_s,
                       modules=modules)  # fmt: skip
    took_s = _cpu_s() - before  # of workers that have ended
    runs = found.runs + found.without
    if found.seed is not None:
        runs = found.seed - found.first_seed + 1  # others were under way
    shown = timeline_lines(found.scenario) if found.scenario else []
    if found.scenario and least:
        with local_engine(limits.workers) as engine:
            small = Shrinker(found.scenario, engine, lambda *_: None, modules).shrink(found.check, least).scenario
        shown = [f"{small.vehicles} vehicles, {small.duration_ns / 1e9:g} s", *timeline_lines(small)]
    return {"bug": bug.name, "protocol": bug.bench, "what": bug.what, "seed": seed,
            "found": found.seed is not None, "check": found.check, "runs": runs, "cpu_s": round(took_s, 1),
            "without": found.without, "reason": found.reason, "least": shown}  # fmt: skip


def _cpu_s() -> float:
    return sum(resource.getrusage(who).ru_utime for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def _planted(bug: Bug, *changes: str) -> Scenario:
    """The scenario of a defect's bench, with the defect planted in the current folder."""
    bench = BENCHES[bug.bench]
    parameters = load_scenario(bench.scenario, bench.changes).spec.agent
    law = json.dumps({"law": plant(bug, Path.cwd()), "parameters": (parameters and parameters.parameters) or {}})
    return load_scenario(bench.scenario, [*bench.changes, f"agent={law}", *changes])


def witnessed(bug: Bug) -> tuple[list[str], list[str]]:
    """The checks that the faults of a defect's witness fail: with the defect, and without it. A law that raises an
    exception counts as `agent`.
    """
    found = []
    for one in (bug, sound_one(bug.bench)):
        result = run(_planted(one, "nemesis=null", f"faults=[{', '.join(WITNESSES[bug.name])}]"))
        failed = [verdict.check.rpartition(":")[2] for verdict in result.checks if not verdict.passed]
        found.append(failed or ([] if result.passed else ["agent"]))
    return found[0], found[1]


def witness_table(bugs: Sequence[Bug]) -> Iterator[str]:
    """The table as Markdown: the faults of each witness, and the checks that fail with them."""
    yield "| protocol | defect | faults | fails | without the defect |"
    yield "|---|---|---|---|---|"
    for bug in bugs:
        with_it, without = witnessed(bug)
        shown = "passes" if not without else f"fails, too: {', '.join(without)}"
        yield f"| {bug.bench} | {bug.what} | {len(WITNESSES[bug.name])} | {', '.join(with_it) or 'nothing'} | {shown} |"


def plant(bug: Bug, folder: Path) -> str:
    """Write copies of the modules of a chain, the last one with the defect; returns the law, as a scenario names it.

    Raises:
        ValueError: the text that is to be changed is not there, or more than once.
    """
    bench = BENCHES[bug.bench]
    # A module is imported once, so each defect has names of its own.
    prefix = "planted_" + bug.name.replace("-", "_")
    names = {module: f"{prefix}_{module.rpartition('.')[2]}" for module in bug.chain}
    for module, name in names.items():
        text = _CORE if module == CORE else _source(module)
        if module == bug.chain[-1] and bug.old:
            if text.count(bug.old) != 1:
                raise ValueError(f"{bug.name}: {module} has {text.count(bug.old)} places like {bug.old!r}, expected 1")
            text = text.replace(bug.old, bug.new)
        for other, planted in names.items():
            text = text.replace(f"from {other} import", f"from {planted} import")
        (folder / f"{name}.py").write_text(text, "utf-8")
    return f"{names[bug.chain[0]]}:{bench.law.partition(':')[2]}"


def _source(module: str) -> str:
    spec = find_spec(module)
    assert spec is not None and spec.origin is not None
    origin = Path(spec.origin)  # of a compiled module the source lies beside it
    return origin.with_name(f"{origin.name.partition('.')[0]}.py").read_text("utf-8")


def _lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()] if path.exists() else []


def table(lines: list[dict[str, Any]]) -> Iterator[str]:
    """The table as Markdown: each defect with the medians of the runs and of the CPU time that searches needed, and the
    least scenario. An interval is that of the median, from the second to the second last of ten searches (97.9 %).
    """
    yield "| protocol | defect | depth | found | runs | CPU time [s] | fails | the least that shows it |"
    yield "|---|---|---|---|---|---|---|---|"
    medians, counted = list[float](), list[float]()
    for name in dict.fromkeys(line["bug"] for line in lines):
        mine = [line for line in lines if line["bug"] == name]
        hits = [line for line in mine if line["found"]]
        runs = sorted(line["runs"] if line["found"] else inf for line in mine)
        took = sorted(line["cpu_s"] if line["found"] else inf for line in mine)
        medians.append(statistics.median(runs))
        depth = str(len(WITNESSES[name])) if name in WITNESSES else ""
        if depth:
            counted.append(medians[-1])
        least = next(("; ".join(line["least"]) for line in hits if line["least"]), "")
        cells = (mine[0]["protocol"], mine[0]["what"], depth, f"{len(hits)} of {len(mine)}", _middle(runs),
                 _middle(took), ", ".join(dict.fromkeys(line["check"] for line in hits)), least)  # fmt: skip
        yield f"| {' | '.join(cells)} |"
    yield ""
    yield f"Found by the median search: {sum(one < inf for one in medians)} of {len(medians)} defects."
    yield f"Of {len(counted)} with a witness: {sum(one < inf for one in counted)}."


def _middle(values: list[float]) -> str:
    """The median of some values in order, and its interval."""
    low, high = values[min(1, len(values) - 1)], values[max(0, len(values) - 2)]
    shown = [f"{one:.3g}" if one < inf else "more" for one in (statistics.median(values), low, high)]
    return f"{shown[0]} ({shown[1]} to {shown[2]})" if len(values) > 2 else shown[0]


if __name__ == "__main__":
    main()
