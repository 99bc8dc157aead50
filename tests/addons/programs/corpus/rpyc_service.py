# rpyc: a service in agent 1, agents 2 and 3 call it, also backwards and without waiting.
import sys, threading, time, rpyc
from rpyc.utils.server import ThreadedServer
me = int(sys.argv[1])

class Service(rpyc.Service):
    def exposed_apply(self, f, xs): return [f(x) for x in xs]
    def exposed_slow(self, x): time.sleep(0.5); return x + 1

if me == 1:
    server = ThreadedServer(Service, hostname="10.0.0.1", port=18861, logger=None); threading.Timer(6, server.close).start(); server.start(); print("stopped")
else:
    time.sleep(1 + 0.25 * me); c = rpyc.connect("10.0.0.1", 18861)
    print(list(c.root.apply(lambda x: x * me, [1, 2, 3])))
    later = rpyc.async_(c.root.slow)(me); print("ready", later.ready); later.wait(); print(later.value); c.close()
