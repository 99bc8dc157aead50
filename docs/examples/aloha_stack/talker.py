"""A modem that talks at random, for UnetStack: it knows nothing of uuv-fleet.

    python talker.py PORT NUMBER MODEMS MEAN_S SEED

It sends 16 bytes to one of the others, after pauses of MEAN_S on average, and counts what it hears.
"""

import random
import sys
import time

from unetpy import UnetSocket

port, number, modems = map(int, sys.argv[1:4])
mean_s, chance = float(sys.argv[4]), random.Random(f"{sys.argv[5]}/{number}")
modem = UnetSocket("127.0.0.1", port)
modem.bind(41)
print("ready", flush=True)
heard, due = 0, time.monotonic() + chance.expovariate(1 / mean_s)
while True:
    left_s = due - time.monotonic()
    if left_s <= 0:
        modem.send([*range(16)], chance.choice([k for k in range(1, modems + 1) if k != number]), 41)
        due += chance.expovariate(1 / mean_s)
    elif modem.receive(max(1, int(1000 * left_s))) is not None:
        heard += 1
        print(f"heard {heard}", flush=True)
