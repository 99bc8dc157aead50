# PySyncObj: Raft over TCP among three agents; each adds to a replicated counter and dictionary.
import sys, time
from pysyncobj import SyncObj, SyncObjConf, replicated
from pysyncobj.batteries import ReplDict
me = int(sys.argv[1]); address = lambda i: f"10.0.0.{i}:4321"

class Counter(SyncObj):
    def __init__(self, d): super().__init__(address(me), [address(i) for i in (1, 2, 3) if i != me], consumers=[d]); self.n = 0
    @replicated
    def add(self, x): self.n += x

d = ReplDict(); c = Counter(d); time.sleep(3)
print("leader known", c._getLeader() is not None)
c.add(10 ** (me - 1), callback=lambda r, e: None); d.set(f"agent{me}", me * me)
time.sleep(2); print("counter", c.n, sorted(d.rawData().items()))
time.sleep(1); c.destroy(); time.sleep(0.3); print("done")
