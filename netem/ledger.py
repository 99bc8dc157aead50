"""The ledger: per directed link, every packet that entered is accounted for exactly once.

sent + duplicated = delivered + sum(lost by cause) + in flight at the end
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from netem.cause import LOSSES, Cause
from netem.condition import Link
from netem.wire.messages import Fate

Count = Annotated[int, Meta(ge=0, le=2**53)]


class Account(msgspec.Struct):
    """Fates of the packets of one directed link."""

    sent: Count = 0
    duplicated: Count = 0
    delivered: Count = 0
    lost: Annotated[dict[str, Count], Meta(description="By cause, those that were lost.")] = {}
    in_flight: Annotated[Count, Meta(description="Those that were on their way at the end.")] = 0
    corrupted: Annotated[Count, Meta(description="Those of the delivered ones that were damaged.")] = 0

    @property
    def balance(self) -> int:
        """Entries minus exits; zero in a balanced ledger."""
        return self.sent + self.duplicated - self.delivered - self.in_flight - sum(self.lost.values())

    @property
    def replaced(self) -> int:
        """Payloads that a newer one took the place of before they were sent, which no channel has lost."""
        return self.lost.get(Cause.REPLACED, 0)

    @property
    def ordered(self) -> Account:
        """The same counts, with the causes of losses in the order of their declaration."""
        lost = {str(cause): self.lost[cause] for cause in LOSSES if cause in self.lost}
        return msgspec.structs.replace(self, lost=lost)

    def to_values(self) -> dict[str, Any]:
        """Plain values, ordered; `msgspec.convert` is the inverse."""
        values: dict[str, Any] = msgspec.to_builtins(self.ordered)
        return values


class Ledger:
    """Exits are counted from final fates; entries by the medium that takes the packets."""

    def __init__(self, links: Iterable[Link]) -> None:
        self.accounts: dict[Link, Account] = {link: Account() for link in sorted(links)}

    def enter(self, link: Link, *, sent: int = 0, duplicated: int = 0) -> None:
        account = self.accounts[link]
        account.sent += sent
        account.duplicated += duplicated

    def settle(self, fates: Iterable[Fate]) -> None:
        """Count final fates.

        Raises:
            KeyError: a fate names a link that does not exist.
            ValueError: the cause of a fate is not a declared one.
        """
        for fate in fates:
            account = self.accounts[(fate.src, fate.dst)]
            if fate.cause == Cause.DELIVERED:
                account.delivered += 1
                account.corrupted += fate.corrupted
            elif fate.cause == Cause.IN_FLIGHT:
                account.in_flight += 1
            elif fate.cause in LOSSES:
                account.lost[fate.cause] = account.lost.get(fate.cause, 0) + 1
            else:
                raise ValueError(f"undeclared cause {fate.cause!r} on link {fate.src}->{fate.dst}")

    def unbalanced_links(self) -> dict[Link, int]:
        return {link: account.balance for link, account in self.accounts.items() if account.balance}

    def total(self) -> Account:
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
