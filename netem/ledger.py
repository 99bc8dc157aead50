"""The ledger: per directed link, every packet that entered is accounted for exactly once.

sent + duplicated = delivered + sum(lost by cause) + in flight at the end
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from netem.causes import CAUSES, DELIVERED, IN_FLIGHT, REPLACED
from netem.condition import Link
from netem.wire.messages import Fate


@dataclass(slots=True)
class Account:
    """One directed link's counts of packets."""

    sent: int = 0
    duplicated: int = 0
    delivered: int = 0
    in_flight: int = 0
    corrupted: int = 0  # of those delivered
    lost: dict[str, int] = field(default_factory=dict)

    @property
    def balance(self) -> int:
        """Entries minus exits; zero in a balanced ledger."""
        return self.sent + self.duplicated - self.delivered - self.in_flight - sum(self.lost.values())

    @property
    def replaced(self) -> int:
        """Payloads that a newer one took the place of before they were sent, which no channel has lost."""
        return self.lost.get(REPLACED, 0)

    def restore(self, values: dict[str, Any]) -> None:
        """The inverse of `to_values`."""
        for name in ("sent", "duplicated", "delivered", "in_flight", "corrupted"):
            setattr(self, name, values[name])
        self.lost = dict(values["lost"])

    def to_values(self) -> dict[str, Any]:
        """Plain values, causes in their declared order."""
        return {
            "sent": self.sent,
            "duplicated": self.duplicated,
            "delivered": self.delivered,
            "lost": {cause: self.lost[cause] for cause in CAUSES if cause in self.lost},
            "in_flight": self.in_flight,
            "corrupted": self.corrupted,
        }


class Ledger:
    """Exits counted from final fates; entries come from whoever let the packets in."""

    def __init__(self, links: Iterable[Link]) -> None:
        self.accounts: dict[Link, Account] = {link: Account() for link in sorted(links)}

    def enter(self, link: Link, *, sent: int = 0, duplicated: int = 0) -> None:
        """Count packets that entered a link."""
        account = self.accounts[link]
        account.sent += sent
        account.duplicated += duplicated

    def settle(self, fates: Iterable[Fate]) -> None:
        """Count final fates.

        Raises:
            KeyError: a fate names a link that does not exist.
            ValueError: a fate's cause is not a declared one.
        """
        for fate in fates:
            account = self.accounts[(fate.src, fate.dst)]
            if fate.cause == DELIVERED:
                account.delivered += 1
                account.corrupted += fate.corrupted
            elif fate.cause == IN_FLIGHT:
                account.in_flight += 1
            elif fate.cause in CAUSES:
                account.lost[fate.cause] = account.lost.get(fate.cause, 0) + 1
            else:
                raise ValueError(f"undeclared cause {fate.cause!r} on link {fate.src}->{fate.dst}")

    def unbalanced(self) -> dict[Link, int]:
        """The links whose entries and exits differ, with the difference."""
        return {link: account.balance for link, account in self.accounts.items() if account.balance}

    def total(self) -> Account:
        """The sum over all links."""
        total = Account()
        for account in self.accounts.values():
            total.sent += account.sent
            total.duplicated += account.duplicated
            total.delivered += account.delivered
            total.in_flight += account.in_flight
            total.corrupted += account.corrupted
            for cause, count in account.lost.items():
                total.lost[cause] = total.lost.get(cause, 0) + count
        return total
