# socketserver: agent 1 has a threading UDP server and a TCP server, agent 2 asks both.
import socket, socketserver, sys, threading, time
me = int(sys.argv[1])

class Udp(socketserver.BaseRequestHandler):
    def handle(self):
        data, s = self.request
        time.sleep(0.5); s.sendto(data.upper(), self.client_address)

class Tcp(socketserver.StreamRequestHandler):
    def handle(self):
        for line in self.rfile: self.wfile.write(line[::-1].strip() + b"\n")

if me == 1:
    servers = [socketserver.ThreadingUDPServer(("0.0.0.0", 5003), Udp), socketserver.ThreadingTCPServer(("0.0.0.0", 5003), Tcp)]
    for x in servers: threading.Thread(target=x.serve_forever).start()
    time.sleep(6)
    for x in servers: x.shutdown(); x.server_close()
    print("shut down")
else:
    t0 = time.monotonic(); time.sleep(1)
    u = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); u.settimeout(2)
    for k in range(3): u.sendto(f"hello {k}".encode(), ("10.0.0.1", 5003))
    for k in range(3): print("udp", u.recv(100), f"{time.monotonic() - t0:.1f}")
    with socket.create_connection(("10.0.0.1", 5003), timeout=2) as c:
        f = c.makefile("rwb"); f.write(b"abc\ndef\n"); f.flush()
        print("tcp", f.readline(), f.readline())
