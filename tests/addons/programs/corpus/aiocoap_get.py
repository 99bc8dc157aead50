# aiocoap: agent 1 serves a resource of 3000 bytes (block-wise) and a counter, agent 2 gets and observes.
import asyncio, os, sys
os.environ["AIOCOAP_SERVER_TRANSPORT"] = "simplesocketserver"; os.environ["AIOCOAP_CLIENT_TRANSPORT"] = "simple6"
import aiocoap, aiocoap.resource as resource
me = int(sys.argv[1])

class Big(resource.Resource):
    async def render_get(self, request): return aiocoap.Message(payload=b"x" * 3000)
    async def render_put(self, request): return aiocoap.Message(code=aiocoap.CHANGED, payload=request.payload[::-1])

async def main():
    if me == 1:
        root = resource.Site(); root.add_resource(["big"], Big())
        context = await aiocoap.Context.create_server_context(root, bind=("10.0.0.1", 5683)); await asyncio.sleep(6); await context.shutdown(); return
    await asyncio.sleep(1.5); context = await aiocoap.Context.create_client_context()
    for code, payload in ((aiocoap.GET, b""), (aiocoap.PUT, b"hello")):
        r = await asyncio.wait_for(context.request(aiocoap.Message(code=code, payload=payload, uri="coap://10.0.0.1/big")).response, 3)
        print("got", r.code, len(r.payload), r.payload[:5])
    await context.shutdown()

asyncio.run(main())
