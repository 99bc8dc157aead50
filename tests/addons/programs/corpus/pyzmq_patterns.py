# pyzmq: PUB/SUB and REQ/REP over TCP with a poller.
import sys, time, zmq
me = int(sys.argv[1]); context = zmq.Context(); t0 = time.monotonic()
if me == 1:
    pub, rep = context.socket(zmq.PUB), context.socket(zmq.REP); pub.bind("tcp://10.0.0.1:5556"); rep.bind("tcp://10.0.0.1:5557")
    due, k = t0 + 1.95, 0
    while time.monotonic() < t0 + 6:
        if rep.poll(50): rep.send_string("answer to " + rep.recv_string())
        if time.monotonic() >= due and k < 4: pub.send_multipart([b"depth", b"%d" % k]); k += 1; due += 0.5
else:
    sub, req = context.socket(zmq.SUB), context.socket(zmq.REQ); sub.connect("tcp://10.0.0.1:5556"); sub.subscribe("depth"); req.connect("tcp://10.0.0.1:5557")
    poller = zmq.Poller(); poller.register(sub, zmq.POLLIN); poller.register(req, zmq.POLLIN); req.send_string(f"agent {me}")
    while time.monotonic() < t0 + 5:
        for s, _ in poller.poll(500): print(s.recv_multipart())
context.destroy(linger=0); print("done")
