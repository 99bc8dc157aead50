# zenoh: three peers find each other by multicast scouting; publish, subscribe, and a queryable.
import json, sys, time, zenoh
me = int(sys.argv[1]); heard = set(); c = zenoh.Config()
for key, value in {"mode": "peer", "listen/endpoints": [f"tcp/10.0.0.{me}:0"], "scouting/multicast/interface": f"10.0.0.{me}", "transport/shared_memory/enabled": False}.items(): c.insert_json5(key, json.dumps(value))
with zenoh.open(c) as s:
    s.declare_subscriber("depth/*", lambda x: heard.add((str(x.key_expr), x.payload.to_string())))
    s.declare_queryable(f"state/{me}", lambda q: q.reply(f"state/{me}", f"good of {me}"))
    time.sleep(2.5)
    for k in range(3): s.put(f"depth/{me}", f"{k} m"); time.sleep(0.7)
    for r in sorted(r.ok.payload.to_string() for r in s.get("state/*", timeout=2) if r.ok): print("reply", r)
    time.sleep(0.5); print(*sorted(heard), sep="\n")
print("done")
