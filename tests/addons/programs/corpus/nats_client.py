# nats-py: publish, subscribe and request at the server of agent 1 (used by nats.sh).
import asyncio, sys, nats
me = int(sys.argv[1]); other = 5 - me

async def main():
    await asyncio.sleep(1.5); nc = await nats.connect("nats://10.0.0.1:4222", name=f"agent{me}")
    async def heard(m): print("heard", m.subject, m.data.decode())
    async def answer(m): await m.respond(b"well, says %d" % me)
    await nc.subscribe(f"depth.{other}", cb=heard); await nc.subscribe(f"ask.{me}", cb=answer); await nc.flush(); await asyncio.sleep(1)
    for k in range(3): await nc.publish(f"depth.{me}", b"%d m" % k); await asyncio.sleep(0.3)
    print((await nc.request(f"ask.{other}", b"?", timeout=1)).data.decode()); await asyncio.sleep(0.5)
    await nc.drain(); print("done")

asyncio.run(main())
