"""A program for UnetStack on a vehicle that moves at 2 m/s, and measures the range to another one."""

import json
import sys
from threading import Event, Thread
from time import monotonic

from unetpy import RangeNtf, RangeReq, Services, UnetSocket

SPEED, START = 2.0, 300.0  # m/s, m
one = UnetSocket("127.0.0.1", int(sys.argv[1]))
gateway = one.getGateway()
node, ranging = (one.agentForService(service) for service in (Services.NODE_INFO, Services.RANGING))
begin, over = monotonic(), Event()
placed = START  # where the modem knows it is


def where() -> float:
    return START + SPEED * (monotonic() - begin)


def move() -> None:
    global placed
    while not over.wait(0.02):
        north = where()
        node.location = [0.0, north, -10.0]  # east, north, up; returns when the modem has answered
        placed = north


Thread(target=move, daemon=True).start()
found = []
for _ in range(8):
    before = placed
    gateway.request(RangeReq(recipient=ranging, to=2), 5000)
    measured = gateway.receive(RangeNtf, 30_000)
    found.append([before, measured.range, where()])
over.set()
print(json.dumps(found))
