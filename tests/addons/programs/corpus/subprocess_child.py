# Children by subprocess: a pipe, a timeout, a child that sends by itself; the father prints what came.
import socket, subprocess, sys, time
me = int(sys.argv[1]); other = 3 - me; t0 = time.monotonic()
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("", 5005)); s.settimeout(3)
print(subprocess.run(["sort", "-r"], input="a\nc\nb\n", text=True, capture_output=True).stdout.split())
try: subprocess.run(["sleep", "5"], timeout=0.5)
except subprocess.TimeoutExpired: print(f"{time.monotonic() - t0:.1f} timeout")
child = f"import socket, time; time.sleep(1); socket.socket(2, 2).sendto(b'child of {me}', ('10.0.0.{other}', 5005))"
p = subprocess.Popen([sys.executable, "-c", child])
print("heard", s.recvfrom(100)[0].decode()); print("ended with", p.wait(), f"{time.monotonic() - t0:.0f}")
q = subprocess.Popen("while read x; do echo got $x; done", shell=True, stdin=-1, stdout=-1, text=True)
print(q.communicate("1\n2\n")[0].split("\n"))
