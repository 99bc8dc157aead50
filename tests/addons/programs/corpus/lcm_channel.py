# lcm: bytes on a channel over UDP multicast, one message in fragments, with a handler thread.
import sys, threading, time, lcm
me = int(sys.argv[1]); heard = []; bus = lcm.LCM("udpm://239.255.76.67:7667?ttl=1")
bus.subscribe("DEPTH.*", lambda channel, data: heard.append((channel, len(data), data[:9].decode())) if not channel.endswith(str(me)) else None)
stop = time.monotonic() + 5

def handle():
    while time.monotonic() < stop: bus.handle_timeout(200)

thread = threading.Thread(target=handle); thread.start(); time.sleep(1.5)
for k in range(3): bus.publish(f"DEPTH{me}", b"%d of %d" % (k, me)); time.sleep(0.5)
bus.publish(f"DEPTH{me}", b"long of %d" % me * 20000); thread.join()
print(*sorted(heard), sep="\n"); print("done")
