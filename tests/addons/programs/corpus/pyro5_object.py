# Pyro5: an object in a daemon of agent 1, agent 2 calls it by its URI.
import sys, threading, time
import Pyro5.api, Pyro5.errors
me = int(sys.argv[1])

@Pyro5.api.expose
class Depth:
    def __init__(self): self.values = []
    def add(self, x): self.values.append(x); return sum(self.values)
    @Pyro5.api.oneway
    def slow(self): time.sleep(1); self.values.append(100)

if me == 1:
    with Pyro5.api.Daemon(host="10.0.0.1", port=9090) as daemon:
        daemon.register(Depth(), "depth"); threading.Timer(6, daemon.shutdown).start(); daemon.requestLoop(); print("stopped")
else:
    time.sleep(1.5)
    with Pyro5.api.Proxy("PYRO:depth@10.0.0.1:9090") as p:
        print(p.add(1), p.add(2)); p.slow(); print(p.add(3)); time.sleep(1.5); print(p.add(4))
        try: p.none()
        except AttributeError as e: print("no such method")
