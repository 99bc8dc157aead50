# Two agents send each other numbered datagrams with asyncio.
import asyncio, sys, time
me = int(sys.argv[1]); other = 3 - me

class Hear(asyncio.DatagramProtocol):
    def datagram_received(self, data, address):
        print(f"{time.monotonic() - t0:.1f} heard {data.decode()} from {address[0]}")

async def main():
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(Hear, local_addr=("0.0.0.0", 5000))
    await asyncio.sleep(0.95)
    for k in range(4):
        transport.sendto(f"{k} of {me}".encode(), (f"10.0.0.{other}", 5000))
        await asyncio.sleep(1)
    transport.close()
    print("done")

t0 = time.monotonic()
asyncio.run(main())
