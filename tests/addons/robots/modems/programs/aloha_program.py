"""Programs for EvoLogics modems that talk when they like: Poisson traffic of instant messages on each port."""

import random
import socket
import sys
from heapq import heapify, heapreplace
from threading import Thread
from time import monotonic, sleep

rate, seconds, ports = float(sys.argv[1]), float(sys.argv[2]), [int(port) for port in sys.argv[3:]]
draws = random.Random(1)
modems = [socket.create_connection(("127.0.0.1", port)) for port in ports]
for modem in modems:
    Thread(target=lambda modem=modem: [None for _ in iter(lambda: modem.recv(65536), b"")], daemon=True).start()
begin = monotonic()
turns = [(begin + draws.expovariate(rate), n) for n in range(len(modems))]
heapify(turns)
sent = 0
while turns[0][0] < begin + seconds:
    at, n = turns[0]
    sleep(max(0.0, at - monotonic()))
    modems[n].sendall(b"+++AT*SENDIM,8,255,noack,12345678\n")
    sent += 1
    heapreplace(turns, (at + draws.expovariate(rate), n))
sleep(1.0)
print(sent)
