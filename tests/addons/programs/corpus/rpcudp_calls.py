# rpcudp: remote calls over UDP, to a living and to an absent agent.
import asyncio, logging, sys
from rpcudp.protocol import RPCProtocol
me = int(sys.argv[1]); other = 3 - me; logging.disable()

class Protocol(RPCProtocol):
    def rpc_greet(self, sender, name): return f"hello {name} of {sender[0]}"
    async def rpc_slow(self, sender, x): await asyncio.sleep(0.5); return x * 2

async def main():
    loop = asyncio.get_running_loop()
    transport, p = await loop.create_datagram_endpoint(lambda: Protocol(wait_timeout=1), local_addr=("0.0.0.0", 5022))
    await asyncio.sleep(1); print(await p.greet((f"10.0.0.{other}", 5022), f"agent {me}"))
    t = loop.time(); print(await p.slow((f"10.0.0.{other}", 5022), me), f"{loop.time() - t:.1f}")
    t = loop.time(); print(await p.greet((f"10.0.0.{other}", 5023), "nobody"), f"{loop.time() - t:.1f}")
    await asyncio.sleep(2); transport.close()

asyncio.run(main())
