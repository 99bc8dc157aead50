"""Ten programs for UnetStack in one: each broadcasts frames at random, at any time or at the beginning of a slot."""

import random
import sys
from heapq import heapify, heapreplace
from time import monotonic, sleep

from unetpy import Services, TxFrameReq, UnetSocket

rate, seconds, slot, ports = float(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]), list(map(int, sys.argv[4:]))
draws = random.Random(1)
gateways = [UnetSocket("127.0.0.1", port).getGateway() for port in ports]
modems = [gateway.agentForService(Services.PHYSICAL) for gateway in gateways]
for gateway in gateways:
    gateway.flush()


def gap() -> float:
    """The time to the next frame of a program: of Poisson traffic, or a whole number of slots."""
    if not slot:
        return draws.expovariate(rate)
    slots = 1
    while draws.random() >= rate * slot:
        slots += 1
    return slots * slot


begin = monotonic() + 0.5
turns = [(begin + gap(), n) for n in range(len(ports))]
heapify(turns)
sent = 0
while turns[0][0] < begin + seconds:
    at, n = turns[0]
    sleep(max(0.0, at - monotonic()))
    gateways[n].send(TxFrameReq(recipient=modems[n], to=0, data=[1, 2, 3, 4]))
    sent += 1
    heapreplace(turns, (at + gap(), n))
sleep(1.0)
print(sent)
