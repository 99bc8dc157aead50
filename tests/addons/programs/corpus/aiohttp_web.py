# aiohttp: a server with JSON and a websocket in agent 1, a client in agents 2 and 3.
import asyncio, sys, aiohttp
from aiohttp import web
me = int(sys.argv[1])

async def position(request): return web.json_response({"x": 1, "of": request.query["of"]})
async def socket(request):
    ws = web.WebSocketResponse(heartbeat=1); await ws.prepare(request)
    async for m in ws: await asyncio.sleep(0.3); await ws.send_str(m.data + " back")
    return ws

async def main():
    if me == 1:
        app = web.Application(); app.router.add_get("/position", position); app.router.add_get("/ws", socket)
        runner = web.AppRunner(app); await runner.setup(); await web.TCPSite(runner, "10.0.0.1", 8081).start()
        await asyncio.sleep(7); await runner.cleanup(); print("stopped"); return
    await asyncio.sleep(2)
    async with aiohttp.ClientSession("http://10.0.0.1:8081") as s:
        async with s.get("/position", params={"of": str(me)}) as r: print(r.status, await r.json())
        async with s.ws_connect("/ws") as ws:
            for k in range(3): await ws.send_str(f"{k} of {me}"); print((await ws.receive(timeout=2)).data); await asyncio.sleep(0.5)

asyncio.run(main())
