# swim-protocol: three agents, failure detection by SWIM over UDP; agent 3 leaves early.
import asyncio, sys
from swimprotocol.members import Members
from swimprotocol.status import Status
from swimprotocol.udp import UdpTransport
from swimprotocol.udp.config import UdpConfig
from swimprotocol.worker import Worker
me = int(sys.argv[1]); name = lambda i: f"10.0.0.{i}:7950"

async def main():
    config = UdpConfig(secret="x", local_name=name(me), peers=[name(i) for i in (1, 2, 3) if i != me], ping_interval=0.3, ping_timeout=0.2, suspect_timeout=0.6, default_host=None, default_port=None)
    members = Members(config); worker = Worker(config, members); transport = UdpTransport(config, worker)
    async with transport, worker:
        await asyncio.sleep(1); members.update(members.local, new_metadata={"depth": b"%d" % (10 * me)})
        await asyncio.sleep(2); show(members)
        if me == 3: return
        await asyncio.sleep(3); show(members)

def show(members): print([(m.name.split(":")[0][-1], m.status.name, m.metadata.get("depth")) for m in sorted(members.non_local, key=lambda m: m.name)])

asyncio.run(main())
