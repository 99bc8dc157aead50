# Signals: an interval timer of the process, a signal to a thread's process, sigtimedwait; each tick sends a datagram.
import os, signal, socket, sys, threading, time
me = int(sys.argv[1]); other = 3 - me; t0 = time.monotonic()
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("", 5010)); s.settimeout(0.2)
def tick(*_): s.sendto(b"tick of %d" % me, (f"10.0.0.{other}", 5010))
signal.signal(signal.SIGALRM, tick); signal.setitimer(signal.ITIMER_REAL, 0.9, 0.5)
signal.signal(signal.SIGUSR1, lambda *_: print(f"{time.monotonic() - t0:.1f} usr1"))
threading.Timer(1.2, os.kill, (os.getpid(), signal.SIGUSR1)).start()
n = 0
while time.monotonic() < t0 + 3.1:
    try: s.recv(100); n += 1
    except socket.timeout: pass
signal.setitimer(signal.ITIMER_REAL, 0); print("heard", n)
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGUSR2]); threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGUSR2)).start()
print(signal.sigtimedwait([signal.SIGUSR2], 2).si_signo == signal.SIGUSR2, signal.sigtimedwait([signal.SIGUSR2], 0.5))
print(f"{time.monotonic() - t0:.1f} done")
