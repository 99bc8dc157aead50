# Sources of chance and identity: everything that differs between two runs is printed and sent.
import hashlib, os, random, secrets, socket, sys, tempfile, time, uuid
me = int(sys.argv[1]); other = 3 - me
folder = tempfile.mkdtemp(); os.rmdir(folder)
values = {"random": random.random(), "urandom": os.urandom(4).hex(), "getrandom": os.getrandom(4).hex(), "secrets": secrets.token_hex(4), "uuid4": str(uuid.uuid4()), "uuid1": str(uuid.uuid1()),
          "hash": hash("text"), "set": list(set("abcdefgh")), "id": id(object()) & 0xFFFFFF, "temp": os.path.basename(folder), "pid": os.getpid(), "host": socket.gethostname(),
          "time": time.time(), "ns": time.time_ns(), "perf": time.perf_counter(), "cpu": time.process_time(), "local": time.ctime(), "dev": open("/dev/urandom", "rb").read(4).hex(), "boot": open("/proc/sys/kernel/random/uuid").read().strip()}
for k, v in values.items(): print(k, v)
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("", 5009)); s.settimeout(4); time.sleep(1)
s.sendto(hashlib.sha256(repr(values).encode()).hexdigest()[:16].encode(), (f"10.0.0.{other}", 5009))
print("heard", s.recv(100).decode()); time.sleep(1); print("done")
