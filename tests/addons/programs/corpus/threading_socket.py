# A thread receives with a timeout and fills a queue, the main thread sends; an event ends it.
import queue, socket, sys, threading, time
me = int(sys.argv[1]); other = 3 - me
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("", 5002)); s.settimeout(0.7)
heard, stop, t0 = queue.Queue(), threading.Event(), time.monotonic()

def listen():
    while not stop.is_set():
        try: heard.put((s.recvfrom(2000), time.monotonic() - t0))
        except socket.timeout: pass

thread = threading.Thread(target=listen); thread.start()
time.sleep(0.95)
for k in range(4):
    s.sendto(f"{k} of {me}".encode(), (f"10.0.0.{other}", 5002))
    try: (data, a), t = heard.get(timeout=1); print(f"{t:.1f} heard {data.decode()} from {a[0]}")
    except queue.Empty: print("nothing")
    time.sleep(1)
stop.set(); thread.join()
print("done")
