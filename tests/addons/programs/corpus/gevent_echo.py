# gevent: a stream server in agent 1, patched sockets and a pool of greenlets in agent 2.
from gevent import monkey; monkey.patch_all()
import socket, sys, time, gevent, gevent.pool, gevent.server
me = int(sys.argv[1]); t0 = time.monotonic()

def serve(s, address):
    x = s.recv(10); time.sleep(0.2 * int(x)); s.sendall(b"echo " + x); s.close()

def ask(k):
    with socket.create_connection(("10.0.0.1", 5031), timeout=3) as s: s.sendall(b"%d" % k); return k, s.recv(100), f"{time.monotonic() - t0:.0f}"

if me == 1:
    server = gevent.server.StreamServer(("10.0.0.1", 5031), serve); server.start(); gevent.sleep(5); server.stop(); print("stopped")
else:
    time.sleep(1.5)
    for x in gevent.pool.Pool(4).imap_unordered(ask, (4, 3, 2, 1)): print(*x)
    with gevent.Timeout(0.5, False): gevent.sleep(2)
    print("done")
