# anyio: UDP echo with a task group, a memory stream and a cancel scope.
import anyio, sys
me = int(sys.argv[1])

async def main():
    start = anyio.current_time(); send, receive = anyio.create_memory_object_stream(10)
    async with await anyio.create_udp_socket(local_host="0.0.0.0", local_port=5020) as u, anyio.create_task_group() as group:
        async def listen():
            async for data, (host, port) in u:
                if data.startswith(b"ask"): await u.sendto(b"back " + data, host, port)
                await send.send((data, host))
        group.start_soon(listen); await anyio.sleep(1)
        for k in range(3):
            if me == 2: await u.sendto(b"ask %d" % k, "10.0.0.1", 5020)
            with anyio.move_on_after(1) as scope: print(*await receive.receive())
            if scope.cancelled_caught: print("nothing")
            await anyio.sleep(0.5)
        print(f"{anyio.current_time() - start:.0f}"); group.cancel_scope.cancel()

anyio.run(main)
