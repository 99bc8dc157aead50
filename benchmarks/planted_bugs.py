"""How many runs a search needs to find a defect that was planted on purpose.

    python benchmarks/planted_bugs.py --most 100 --workers 2 >> planted.jsonl
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
import statistics
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from math import inf
from pathlib import Path
from typing import Any

from fleet.execution.stepped_run import run
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario, timeline_lines
from fleet.study.engine import local_engine
from fleet.study.modules import modules_of
from fleet.study.search import search
from fleet.study.shrink import Shrinker

SHRINK_RUNS = 150
ELECTION, AVERAGE = "fleet.protocols.election", "fleet.protocols.average"
AUCTION, BIDDER, EVENT = "fleet.protocols.bundle_auction", "fleet.protocols.bidder", "fleet.protocols.event_triggered"
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
# Each bench has faults that its protocol survives without a defect. Long one-way silence, two deaths at a time in an
# auction, and faults that leave no time to recover make the sound ones fail, too.
_SWARM = "nemesis={mode: swarm, until: 45 s, pick: [%s]}"
_GRID = "nemesis={every: %s, for: %s, until: %s, pick: [%s]}"
_COMMON = ("duration=60 s", "tick=100 ms", "log={every: 1 tick, snapshot: 0 s}", "faults=[]", "expect=pass")


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
        *_COMMON, "moored=true", _SWARM % "partition, pause, kill",
        'network.links={"*": delay 100ms 30ms loss 10%}',
        "checks={fleet.protocols.checks:AtMostOneLeader: {per: fleet}, "
        "fleet.protocols.checks:AgreeAfterHeal: {within: 9 s, quorum: fleet}}",
    )),
    "average": Bench("average", f"{AVERAGE}:ExactAverage", (
        *_COMMON, "moored=true", _SWARM % "kill",
        'network.links={"*": delay 100ms 50ms loss 10% duplicate 5%}',
        "checks={fleet.protocols.checks:TrueMean: {below: 0.01, within: 10 s}}",
    )),
    "auction": Bench("auction", f"{AUCTION}:BundleAuction", (
        *_COMMON, _GRID % ("12 s", "7 s", "31 s", "kill"), "checks.tumbled=waived",
    )),
    "event-triggered": Bench("event-triggered", f"{EVENT}:EventTriggered", (
        *_COMMON, _GRID % ("5 s", "4 s", "45 s", "down, deaf, mute"),
        "checks={formation_error: {below: 1 m, after: 56 s}, tumbled: waived}",
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
    _average("takes-nothing-back", _TAKES_BACK, "", "what was given to a vehicle that went silent is lost"),
    _average("opens-at-0", "{j: _Link(tick) for j", "{j: _Link(0) for j", "a restart does not open its links anew"),
    _average("never-forgets", "if 0 <= link.heard < nav.tick - self._forget_ticks:", "if link.heard < -1:",
             "a neighbour that is gone is never dropped"),
    _average("old-epoch", "            if opened == link.opened:\n", "            if True:\n",
             "sums of a link from before it was opened anew count"),
    _average("gives-to-the-silent", "link.heard, link.mutual = -1, False", "link.heard = -1",
             "shares go to a neighbour that is gone"),
    _average("old-round", "if delivery.sent_tick <= link.heard:", "if delivery.sent_tick < 0:",
             "an old round is accepted"),
    Bug("no-tie-break-of-bids", "auction", (AUCTION, BIDDER), "bid == other and bidder < winner", "bid == other",
        "of equal bids each believes its own"),
    Bug("double-bid", "auction", (AUCTION, BIDDER), "or not outbids(bid, self.number, self.bids[j], self.winners[j])",
        "", "it bids for what somebody else has won"),
    Bug("keeps-the-rest", "auction", (AUCTION, BIDDER), "del self.bundle[kept:]", "del self.bundle[kept : kept + 1]",
        "who is outbid keeps what it chose after that"),
    Bug("old-news", "auction", (AUCTION, BIDDER), _OLD_NEWS, "", "old news are believed"),
    Bug("never-released", "auction", (AUCTION,), "> self._silence_ticks and", "> 10**9 and",
        "the places of a vehicle that is gone stay its own"),
    Bug("no-last-word", "event-triggered", (EVENT,), "            and nav.tick - told[0] < self._silence_ticks\n", "",
        "a message that was lost is never repeated"),
    Bug("late-state", "core", (CORE, FORMATION, AGENT, NEIGHBOURS),
        "newest is not None and message.sent_tick <= newest.sent_tick", "False", "a late state replaces a newer one"),
    Bug("neighbour-never-dropped", "core", (CORE, FORMATION, AGENT, NEIGHBOURS),
        "self._drop_after is not None and ticks > self._drop_after", "False", "a neighbour that is gone still counts"),
    Bug("standby-for-ever", "core", (CORE, FORMATION, AGENT), "        leads = now - since > self._standby_ticks\n",
        "        leads = self._leads or now - since > self._standby_ticks\n", "who stood by leads on when it need not"),
    Bug("standby-never", "core", (CORE, FORMATION, AGENT), "now - since > self._standby_ticks",
        "now - since > 10**9", "nobody takes over"),
)  # fmt: skip

# Faults, made by hand, with which a defect fails its bench, while the sound protocol passes; none are needed for an
# empty list. A defect that has no list here may be invisible on its bench: reordering that rounds do not have, bids
# that never tie, sums that repair themselves.
WITNESSES: dict[str, tuple[str, ...]] = {
    # Vehicle 3 granted 1 its lease until 25 s, and has forgotten it. 4 and 5 have not heard 1 since 20 s, so they are
    # free at 23 s, and with 3 they are a majority.
    "no-silence-after-start": (
        '{at: 20 s, for: 2 s, partition: "1,2,3 / 4,5"}',
        '{at: 22 s, for: 10 s, partition: "1,2 / 3,4,5"}',
        "{at: 22 s, for: 200 ms, kill: 3}",
    ),
    # The grants of 3, 4 and 5 end at 23 s, that of 2 at 25 s.
    "leads-too-long": ('{at: 20 s, for: 12 s, partition: "1,2 / 3,4,5"}', "{at: 22500 ms, for: 6 s, pause: 1}"),
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
    parser.add_argument("--most", type=int, default=2000, help="runs of a search")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", nargs="*", default=[], help="names of defects or protocols")
    parser.add_argument("--sound", action="store_true", help="search the protocols without any defect")
    parser.add_argument("--seed", type=int, default=1)
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
            wanted = not given.only or {bug.name, bug.bench} & set(given.only)
            if wanted and (bug.name, given.seed) not in done:
                least = 0 if given.no_shrink else SHRINK_RUNS
                print(json.dumps(searched(bug, given.most, given.workers, given.seed, least)), flush=True)


def searched(bug: Bug, most: int, workers: int, seed: int = 1, least: int = 0) -> dict[str, Any]:
    """One search for a defect, which is planted in the current folder; `least`: runs for making it smaller."""
    folder = Path.cwd()
    scenario = _planted(bug, f"seed={seed}")
    with local_engine(workers) as engine:
        modules = modules_of([scenario], folder)
        found = search(scenario, engine, lambda _: None, most_runs=most, modules=modules)
        runs = found.runs + found.without
        if found.seed is not None:
            runs = found.seed - found.first_seed + 1  # others were under way
        shown = _shrunk(found.scenario, found.check, engine, modules, least) if found.scenario else []
    return {"bug": bug.name, "protocol": bug.bench, "what": bug.what, "seed": seed, "most": most,
            "found": found.seed is not None, "check": found.check, "runs": runs, "without": found.without,
            "reason": found.reason, "least": shown}  # fmt: skip


def _planted(bug: Bug, *changes: str) -> Scenario:
    """The scenario of a defect's bench, with the defect planted in the current folder."""
    bench = BENCHES[bug.bench]
    parameters = load_scenario(bench.scenario).spec.agent
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


def _shrunk(scenario: Scenario, check: str, engine: Any, modules: Any, most: int) -> list[str]:
    if not most:
        return timeline_lines(scenario)
    found = Shrinker(scenario, engine, lambda *_: None, modules).shrink(check, most)
    return [f"{found.scenario.vehicles} vehicles, {found.scenario.duration_ns / 1e9:g} s",
            *timeline_lines(found.scenario)]  # fmt: skip


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
    """The table as Markdown: each defect with the median of the runs that it needed, and the least scenario."""
    yield "| protocol | defect | runs | fails | the least that shows it |"
    yield "|---|---|---|---|---|"
    medians = list[float]()
    for name in dict.fromkeys(line["bug"] for line in lines):
        mine = [line for line in lines if line["bug"] == name]
        middle = statistics.median(line["runs"] if line["found"] else inf for line in mine)
        medians.append(middle)
        cell = f"{middle:g}" if middle < inf else f"not in {max(line['most'] for line in mine)}"
        found = min((line for line in mine if line["found"]), key=lambda line: len(line["least"]), default=None)
        least = "; ".join(found["least"]) if found else ""
        fails = found["check"] if found else ""
        yield f"| {' | '.join((mine[0]['protocol'], mine[0]['what'], cell, fails, least))} |"
    yield ""
    yield f"Found {sum(one < inf for one in medians)} of {len(medians)}, median {statistics.median(medians):g} runs."


if __name__ == "__main__":
    main()
