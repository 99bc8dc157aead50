# Agent 1 serves lines over TCP, agents 2 and 3 ask it; the second request runs into a timeout.
import asyncio, sys, time
me = int(sys.argv[1])

async def serve(reader, writer):
    while line := await reader.readline():
        if line.startswith(b"slow"): await asyncio.sleep(1.5)
        writer.write(b"echo " + line); await writer.drain()
    print("closed by", writer.get_extra_info("peername")[0])
    writer.close()

async def main():
    t0 = time.monotonic()
    if me == 1:
        async with await asyncio.start_server(serve, "10.0.0.1", 5001):
            await asyncio.sleep(6)
        return
    await asyncio.sleep(0.5 + 0.2 * me)
    reader, writer = await asyncio.open_connection("10.0.0.1", 5001)
    for word in ("fast", "slow"):
        writer.write(f"{word} {me}\n".encode())
        try: print(await asyncio.wait_for(reader.readline(), 1), f"{time.monotonic() - t0:.1f}")
        except asyncio.TimeoutError: print(f"{time.monotonic() - t0:.1f} timeout")
    print(await reader.readline(), f"{time.monotonic() - t0:.1f}")
    writer.close(); await writer.wait_closed()

asyncio.run(main())
