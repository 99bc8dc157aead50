"""The rules of `fleet protocol check`, and the form of a verdict."""

from __future__ import annotations

from dataclasses import dataclass

ASKS = "asks cfg for its slice"
HELLO = "says hello on cmd and tx: role agent, its number, the incarnation of cfg, the protocol version"
READY = "says hello with echo set on cmd, once both were echoed"
TOKEN = "declares its liveliness token"
COMMANDS = "answers each nav with one cmd: its incarnation and tick, three finite numbers, all telemetry or none"
TRANSMITS = "puts one tx at each round tick, before the cmd, and none at other ticks"
LATE = "waits with its answer until the inbox is known up to the tick"
PARTS = "takes an inbox in parts for known only when the last is there"
DAMAGED = "survives payloads that the network has damaged"
MALFORMED = "drops malformed messages and goes on"
EARLIER = "ignores nav, rx and end of an earlier life"
GAP = "goes on after ticks in which it was not asked"
ROLLS = "answers a nav with roll, its sixth field"
SHOWS = "answers a nav with what its clock shows, its seventh field"
BELIEVES = "answers a nav with belief, its eighth field"
MEMORY = "puts memory, if at all, before the cmd of a tick at which it is asked for"
UNASKED = "puts nothing that it was not asked for"
FORM = "puts well-formed messages of its own kinds only"
ENDS = "closes its session when it is told the end"
CHECKS = (
    *(ASKS, HELLO, READY, TOKEN, COMMANDS, TRANSMITS, LATE, PARTS, DAMAGED),
    *(MALFORMED, EARLIER, GAP, ROLLS, SHOWS, BELIEVES, MEMORY, UNASKED, FORM, ENDS),
)


@dataclass(frozen=True, slots=True)
class ProtocolCheck:
    """One verdict; None if the exchange did not get that far."""

    what: str
    passed: bool | None
    expected: str = ""
    got: str = ""

    def __str__(self) -> str:
        if self.passed:
            return f"pass  {self.what}"
        if self.passed is None:
            return f"----  {self.what}: not reached"
        return f"FAIL  {self.what}: expected {self.expected}; got {self.got}"
