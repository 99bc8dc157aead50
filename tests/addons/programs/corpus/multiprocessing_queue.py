# multiprocessing: a forked process listens on UDP and hands on through a queue, another squares numbers through a pipe.
import multiprocessing as mp, socket, sys, time
me = int(sys.argv[1]); other = 3 - me

def listen(queue):
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("", 5004))
    for k in range(3): data, a = s.recvfrom(1000); queue.put((data.decode(), a[0], time.monotonic()))

def square(pipe):
    while (x := pipe.recv()) is not None: time.sleep(0.2); pipe.send(x * x)

if __name__ == "__main__":
    t0 = time.monotonic(); queue = mp.Queue(); here, there = mp.Pipe()
    ps = [mp.Process(target=listen, args=(queue,)), mp.Process(target=square, args=(there,))]
    for p in ps: p.start()
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); time.sleep(0.95)
    for k in range(3):
        here.send(10 * me + k); s.sendto(str(here.recv()).encode(), (f"10.0.0.{other}", 5004)); time.sleep(1)
    for k in range(3): text, a, t = queue.get(timeout=3); print(f"{t - t0:.1f} heard {text} from {a}")
    here.send(None)
    for p in ps: p.join(2)
    print("ended with", [p.exitcode for p in ps])
