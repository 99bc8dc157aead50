# uvloop: a datagram endpoint, a TCP server, timers and a child, on libuv's loop.
import asyncio, sys, uvloop
me = int(sys.argv[1]); other = 3 - me

class Hear(asyncio.DatagramProtocol):
    def datagram_received(self, data, address): print("udp", data.decode(), address[0])

async def echo(reader, writer):
    writer.write(b"echo " + await reader.read(100)); await writer.drain(); writer.close()

async def main():
    loop = asyncio.get_running_loop(); start = loop.time()
    transport, _ = await loop.create_datagram_endpoint(Hear, local_addr=("0.0.0.0", 5032))
    server = await asyncio.start_server(echo, "0.0.0.0", 5032); await asyncio.sleep(1)
    for k in range(3):
        transport.sendto(b"%d of %d" % (k, me), (f"10.0.0.{other}", 5032)); await asyncio.sleep(0.5)
        reader, writer = await asyncio.open_connection(f"10.0.0.{other}", 5032); writer.write(b"%d" % k)
        print("tcp", (await reader.read(100)).decode()); writer.close()
    p = await asyncio.create_subprocess_exec("echo", "a child", stdout=-1); print((await p.communicate())[0])
    await asyncio.sleep(1); server.close(); transport.close(); print(f"{loop.time() - start:.0f} done")

uvloop.run(main())
