# kademlia: three agents, a table over UDP; agent 2 sets a value, all get it.
import asyncio, logging, sys
from kademlia.network import Server
me = int(sys.argv[1]); logging.disable()

async def main():
    server = Server(node_id=bytes([me]) * 20); await server.listen(8468)
    await asyncio.sleep(0.7 + 0.2 * me)
    if me > 1: print("bootstrap", len(await server.bootstrap([("10.0.0.1", 8468)])))
    await asyncio.sleep(1)
    if me == 2: print("set", await server.set("key", "value"))
    await asyncio.sleep(1.5); print("get", await server.get("key"), await server.get("absent"))
    print("neighbours", sorted(ip for _, ip, _ in map(tuple, server.protocol.router.find_neighbors(server.node))))
    await asyncio.sleep(2); server.stop()

asyncio.run(main())
