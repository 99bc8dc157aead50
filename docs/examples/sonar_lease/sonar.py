"""A lease of the water, as an asyncio program that knows nothing of uuv-fleet: one member at a time uses its sonar.

    python sonar.py NUMBER MEMBERS [HOST]
    python sonar.py 1 3 10.0.0.{}

Members talk over UDP; HOST is a pattern for the host of each. Who wants the water asks all members, itself included,
for their votes. A member votes for one asker at a time, until this one frees the vote or the lease is over. With more
than half of the votes the asker uses the water for 0.3 s, and frees the votes. Each ask has a number of its own. No
answer is a no.

It prints the time (CLOCK_MONOTONIC) with `1 sonar` when it begins, with `0 sonar` when it ends, and with its votes.
"""

import asyncio
import json
import random
import sys
import time

PORT = 9400
LEASE_S, USE_S, PATIENCE_S = 1.0, 0.3, 0.5


class Member(asyncio.DatagramProtocol):
    """One member: it votes, and it asks."""

    def __init__(self, number: int, members: int, host: str) -> None:
        self.number, self.members = number, members
        self.hosts = {host.format(i): i for i in range(1, members + 1)}
        self.voted, self.until = (0, 0), time.monotonic() + LEASE_S  # a life before may have voted
        self.asked, self.votes, self.enough = 0, set(), asyncio.Event()
        self.tasks = set()

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, source: tuple) -> None:
        task = asyncio.create_task(self.hear(self.hosts[source[0]], *json.loads(data)))
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    def send(self, to: list, *message) -> None:
        for host in to:
            self.transport.sendto(json.dumps(message).encode(), (host, PORT))

    async def say(self, text: str) -> None:
        """Print a line in a thread, since a pipe may be full."""
        await asyncio.to_thread(print, f"{time.monotonic():.3f} {text}", flush=True)

    async def hear(self, other: int, kind: str, number: int) -> None:
        if kind == "ask":
            await self.vote(other, number)
        elif kind == "free" and self.voted == (other, number):
            self.until = 0.0
        elif kind == "yes" and number == self.asked:
            self.votes.add(other)
            if 2 * len(self.votes) > self.members:
                self.enough.set()

    async def vote(self, asker: int, number: int) -> None:
        now = time.monotonic()
        if now < self.until and asker != self.voted[0]:
            return
        self.voted, self.until = (asker, number), now + LEASE_S
        await self.say(f"votes for {asker}")
        self.send([host for host, i in self.hosts.items() if i == asker], "yes", number)

    async def use(self) -> None:
        """Ask for the water once, and use it if more than half of the members say yes."""
        begun = time.monotonic()
        self.asked, self.votes = round(begun * 1000), set()  # no life before had this number
        self.enough.clear()
        self.send([*self.hosts], "ask", self.asked)
        try:
            await asyncio.wait_for(self.enough.wait(), PATIENCE_S)
            if time.monotonic() + USE_S < begun + LEASE_S:
                await self.say("1 sonar")
                await asyncio.sleep(USE_S)
                await self.say("0 sonar")
        except TimeoutError:
            pass
        self.send([*self.hosts], "free", self.asked)

    async def work(self) -> None:
        await self.say("0 sonar")
        while True:
            await self.use()
            await asyncio.sleep(random.choice((0.0, random.random())))  # sometimes more is to be done at once


async def main(number: int, members: int, host: str = "10.0.0.{}") -> None:
    loop = asyncio.get_running_loop()
    _, member = await loop.create_datagram_endpoint(lambda: Member(number, members, host), ("0.0.0.0", PORT))
    await member.work()


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    asyncio.run(main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:]))
