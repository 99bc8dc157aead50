# asyncio-dgram: agent 1 echoes, agent 2 asks over a connected datagram stream.
import asyncio, asyncio_dgram, sys
me = int(sys.argv[1])

async def main():
    if me == 1:
        stream = await asyncio_dgram.bind(("0.0.0.0", 8888))
        for k in range(3): data, a = await asyncio.wait_for(stream.recv(), 6); print(data, a[0]); await stream.send(data[::-1], a)
        await asyncio.sleep(0.5); stream.close(); return
    await asyncio.sleep(1.5); stream = await asyncio_dgram.connect(("10.0.0.1", 8888))
    for k in range(3): await stream.send(b"hello %d" % k); print((await stream.recv())[0]); await asyncio.sleep(1)
    stream.close()

asyncio.run(main())
