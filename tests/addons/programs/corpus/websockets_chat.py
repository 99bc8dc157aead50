# websockets: a chat; agent 1 hands each message on to the others.
import asyncio, sys, websockets
me = int(sys.argv[1]); members = set()

async def handle(ws):
    members.add(ws)
    try:
        async for m in ws: websockets.broadcast(members - {ws}, m)
    finally: members.discard(ws)

async def main():
    if me == 1:
        async with websockets.serve(handle, "10.0.0.1", 8765, ping_interval=1): await asyncio.sleep(6.5)
        print("stopped"); return
    await asyncio.sleep(1.5)
    async with websockets.connect("ws://10.0.0.1:8765") as ws:
        async def talk():
            for k in range(3): await asyncio.sleep(0.5); await ws.send(f"{k} of {me}")
            await asyncio.sleep(1); await ws.close()
        task = asyncio.create_task(talk())
        async for m in ws: print("heard", m)
        await task
    print("closed", ws.close_code)

asyncio.run(main())
