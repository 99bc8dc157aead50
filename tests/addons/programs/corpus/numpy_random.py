# numpy: chance without a seed, sent as bytes, and a product of matrices (BLAS has threads).
import socket, sys, time
import numpy
me = int(sys.argv[1]); other = 3 - me; t0 = time.monotonic()
print("legacy", numpy.random.rand(), "default", numpy.random.default_rng().random(), "integers", numpy.random.randint(0, 1000, 5))
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("", 5012)); s.settimeout(3); time.sleep(1)
for k in range(3):
    x = numpy.random.standard_normal(4); s.sendto(x.tobytes(), (f"10.0.0.{other}", 5012)); y = numpy.frombuffer(s.recv(1000))
    print("sent", x.round(3), "heard", y.round(3)); time.sleep(1)
a = numpy.ones((600, 600)); print("product", (a @ a).sum()); print(f"{time.monotonic() - t0:.0f} done")
