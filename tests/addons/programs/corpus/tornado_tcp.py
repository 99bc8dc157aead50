# tornado: a TCP server and a periodic callback in agent 1, an IOStream client in agent 2.
import asyncio, sys
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.tcpclient import TCPClient
from tornado.tcpserver import TCPServer
me = int(sys.argv[1])

class Server(TCPServer):
    streams = []
    async def handle_stream(self, stream, address): self.streams.append(stream); print("connected", address[0])

async def main():
    if me == 1:
        s = Server(); s.listen(8766, "10.0.0.1"); k = iter(range(100))
        beat = PeriodicCallback(lambda: [x.write(b"beat %d\n" % next(k)) for x in s.streams if not x.closed()], 500); beat.start()
        await asyncio.sleep(6); beat.stop(); s.stop(); print("stopped"); return
    await asyncio.sleep(1.25); start = IOLoop.current().time(); stream = await TCPClient().connect("10.0.0.1", 8766)
    for k in range(4): print(await stream.read_until(b"\n"))
    print(f"{IOLoop.current().time() - start:.0f}"); stream.close()

asyncio.run(main())
