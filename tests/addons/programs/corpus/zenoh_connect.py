# zenoh: agent 1 is the router at tcp/10.0.0.1:7447, agents 2 and 3 are clients and publish with liveliness.
import json, sys, time, zenoh
me = int(sys.argv[1]); t0 = time.monotonic(); c = zenoh.Config(); end = "listen" if me == 1 else "connect"
for key, value in {"mode": "router" if me == 1 else "client", f"{end}/endpoints": ["tcp/10.0.0.1:7447"], "scouting/multicast/enabled": False, "transport/shared_memory/enabled": False}.items(): c.insert_json5(key, json.dumps(value))
if me > 1: time.sleep(1)
with zenoh.open(c) as s:
    if me > 1: token = s.liveliness().declare_token(f"alive/{me}")
    sub = s.declare_subscriber("depth/*", lambda x: print("heard", x.key_expr, x.payload.to_string()))
    time.sleep(1)
    for k in range(3):
        if me > 1: s.put(f"depth/{me}", str(k))
        time.sleep(0.6)
    if me == 1: print("alive", sorted(str(r.ok.key_expr) for r in s.liveliness().get("alive/*", timeout=2)))
    time.sleep(2 if me == 1 else 1)
print("done")
