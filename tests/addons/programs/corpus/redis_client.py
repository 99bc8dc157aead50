# redis-py: keys with an expiry, a list to wait at, and publish/subscribe (used by redis_pubsub.sh).
import sys, time, redis, redis.backoff, redis.retry
me = int(sys.argv[1]); t0 = time.monotonic(); time.sleep(1.2)
r = redis.Redis("10.0.0.1", 6379, decode_responses=True, retry=redis.retry.Retry(redis.backoff.NoBackoff(), 0)); print("ping", r.ping())
if me == 2:
    p = r.pubsub(ignore_subscribe_messages=True); p.subscribe("chat")
    print("blpop", r.blpop("list", timeout=3)); r.set("key", "value", px=700); print(r.get("key"), r.incr("n"))
    until = time.monotonic() + 1.5
    while time.monotonic() < until:
        if m := p.get_message(timeout=0.2): print("heard", m["data"])
    print("after", r.get("key"), f"{time.monotonic() - t0:.0f}")
else:
    time.sleep(1); r.rpush("list", "item")
    for k in range(3): time.sleep(0.3); r.publish("chat", f"{k} of {me}")
    time.sleep(2)
    try: r.shutdown(nosave=True)
    except redis.exceptions.ConnectionError: pass
    print("shut down")
