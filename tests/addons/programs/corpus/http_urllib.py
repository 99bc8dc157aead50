# http.server in agent 1, urllib in agents 2 and 3; a GET that is too slow, and a POST.
import http.server, sys, threading, time, urllib.request
me = int(sys.argv[1]); t0 = time.monotonic()

class Handler(http.server.BaseHTTPRequestHandler):
    def answer(self, body):
        self.send_response(200); self.send_header("Content-Length", str(len(body))); self.end_headers()
        try: self.wfile.write(body)
        except OSError: print("the client is gone")
    def do_GET(self):
        if self.path == "/slow": time.sleep(2)
        self.answer(b"x" * 20000 if self.path == "/big" else self.path.encode())
    def do_POST(self): self.answer(self.rfile.read(int(self.headers["Content-Length"]))[::-1])
    def log_message(self, form, *args): print(f"{time.monotonic() - t0:.1f} {self.client_address[0]}", form % args)

if me == 1:
    server = http.server.ThreadingHTTPServer(("10.0.0.1", 8080), Handler)
    threading.Timer(6, server.shutdown).start(); server.serve_forever()
else:
    time.sleep(0.5 + 0.25 * me)
    for path, data in (("/big", None), ("/slow", None), ("/post", b"hello")):
        try:
            with urllib.request.urlopen("http://10.0.0.1:8080" + path, data, timeout=1) as r: body = r.read(); print(path, r.status, len(body), body[:5])
        except OSError as e: print(path, type(e).__name__, e)
        print(f"{time.monotonic() - t0:.1f}")
