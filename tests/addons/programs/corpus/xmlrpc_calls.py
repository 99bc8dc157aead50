# xmlrpc: agent 1 serves functions and a fault, agent 2 calls them.
import sys, threading, time, xmlrpc.client, xmlrpc.server
me = int(sys.argv[1]); t0 = time.monotonic()
if me == 1:
    server = xmlrpc.server.SimpleXMLRPCServer(("10.0.0.1", 8000), logRequests=False, allow_none=True)
    server.register_function(lambda a, b: a + b, "add")
    server.register_function(lambda: xmlrpc.client.DateTime(int(time.time()) // 10**7 * 10**7), "when")
    server.register_function(lambda: 1 // 0, "wrong")
    server.register_function(time.sleep, "sleep")
    threading.Timer(6, server.shutdown).start(); server.serve_forever(); print("shut down")
else:
    time.sleep(1)
    with xmlrpc.client.ServerProxy("http://10.0.0.1:8000", allow_none=True) as p:
        print(p.add(2, 3), p.when())
        try: p.wrong()
        except xmlrpc.client.Fault as e: print(e.faultString)
        p.sleep(1.5); print(f"{time.monotonic() - t0:.1f}")
