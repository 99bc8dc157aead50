# selectors: one loop with a UDP socket, a non-blocking TCP listener and its connections, and a timer.
import selectors, socket, sys, time
me = int(sys.argv[1]); other = 3 - me; t0 = time.monotonic(); sel = selectors.DefaultSelector()
u = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); u.bind(("", 5007)); u.setblocking(False); sel.register(u, selectors.EVENT_READ, "udp")
l = socket.create_server(("", 5007)); l.setblocking(False); sel.register(l, selectors.EVENT_READ, "listen")
c = socket.socket(); c.setblocking(False); due, k = t0 + 0.95, 0
while time.monotonic() < t0 + 5.5:
    for key, events in sel.select(max(0, due - time.monotonic())):
        t = f"{time.monotonic() - t0:.1f}"
        if key.data == "listen": x, a = l.accept(); x.setblocking(False); sel.register(x, selectors.EVENT_READ, "tcp"); print(t, "accepted", a[0])
        elif key.data == "connect": print(t, "connected", c.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)); c.sendall(b"by tcp %d" % me); c.shutdown(socket.SHUT_WR); sel.unregister(c)
        elif key.data == "udp": print(t, *u.recvfrom(100)[:1])
        else:
            data = key.fileobj.recv(100); print(t, "tcp", data)
            if not data: sel.unregister(key.fileobj); key.fileobj.close()
    if time.monotonic() >= due:
        u.sendto(b"udp %d of %d" % (k, me), (f"10.0.0.{other}", 5007)); due += 1; k += 1
        if k == 2: print("connect_ex", c.connect_ex((f"10.0.0.{other}", 5007))); sel.register(c, selectors.EVENT_WRITE, "connect")
print("done")
