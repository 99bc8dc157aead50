# trio: a TCP server in a nursery, two clients, timeouts and a thread.
import sys, time, trio
me = int(sys.argv[1])

async def serve(stream):
    async for data in stream: await trio.to_thread.run_sync(time.sleep, 0.3); await stream.send_all(data.swapcase())

async def main():
    start = trio.current_time()
    if me == 1:
        with trio.move_on_after(6): await trio.serve_tcp(serve, 5021, host="10.0.0.1")
        print(f"{trio.current_time() - start:.1f} stopped"); return
    await trio.sleep(0.5 + 0.25 * me)
    async with await trio.open_tcp_stream("10.0.0.1", 5021) as stream:
        for k in range(3):
            await stream.send_all(f"Hello {k} of {me}".encode())
            with trio.move_on_after(1): print(await stream.receive_some(), f"{trio.current_time() - start:.1f}")
            await trio.sleep(0.5)

trio.run(main)
