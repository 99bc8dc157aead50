# uvicorn serves an ASGI function in agent 1, httpx asks: at once, streamed, and too slow.
import asyncio, sys
me = int(sys.argv[1])

async def app(scope, receive, send):
    if scope["type"] != "http": return
    if scope["path"] == "/slow": await asyncio.sleep(2)
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-type", b"text/plain")]})
    for k in range(3): await send({"type": "http.response.body", "body": b"part %d\n" % k, "more_body": True}); await asyncio.sleep(0.2)
    await send({"type": "http.response.body", "body": b"end"})

async def main():
    if me == 1:
        import uvicorn
        server = uvicorn.Server(uvicorn.Config(app, host="10.0.0.1", port=8082, log_level="error", lifespan="off"))
        asyncio.get_running_loop().call_later(6, setattr, server, "should_exit", True); await server.serve(); print("stopped"); return
    import httpx
    await asyncio.sleep(1.5)
    async with httpx.AsyncClient(base_url="http://10.0.0.1:8082", timeout=1) as c:
        print(repr((await c.get("/")).text))
        async with c.stream("GET", "/") as r: print([line async for line in r.aiter_lines()])
        try: await c.get("/slow")
        except httpx.ReadTimeout as e: print("timeout")

asyncio.run(main())
