# concurrent.futures: agent 2 asks agent 1 by four threads, a pool of two processes counts beside it.
import concurrent.futures as cf, math, socket, sys, threading, time
me = int(sys.argv[1]); t0 = time.monotonic()

def ask(k):
    with socket.create_connection(("10.0.0.1", 5006)) as c: c.sendall(bytes([k])); return k, c.recv(10)

def answer(c):
    with c: x = c.recv(1); time.sleep(0.3 * x[0]); c.sendall(b"%d" % x[0] ** 2)

if __name__ == "__main__" and me == 1:
    s = socket.create_server(("10.0.0.1", 5006)); s.settimeout(6)
    with cf.ThreadPoolExecutor(4) as pool:
        for x in pool.map(answer, [s.accept()[0] for k in range(4)]): pass
    print("answered")
elif __name__ == "__main__":
    time.sleep(1)
    with cf.ThreadPoolExecutor(4) as threads, cf.ProcessPoolExecutor(2) as processes:
        numbers = processes.map(math.factorial, range(6))
        for f in cf.as_completed([threads.submit(ask, k) for k in range(4)], timeout=5): print(f.result(), f"{time.monotonic() - t0:.1f}")
        print(list(numbers))
