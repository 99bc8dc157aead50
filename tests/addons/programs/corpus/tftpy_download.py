# tftpy: agent 1 serves a directory by TFTP, agent 2 downloads a file of 10 kB.
import os, sys, threading, time, tftpy
me = int(sys.argv[1]); t0 = time.monotonic()
if me == 1:
    os.makedirs("root", exist_ok=True); open("root/f", "wb").write(bytes(range(256)) * 40)
    server = tftpy.TftpServer("root"); threading.Timer(5, server.stop, (True,)).start()
    server.listen("0.0.0.0", 6969, timeout=1); print("stopped")
else:
    time.sleep(1); tftpy.TftpClient("10.0.0.1", 6969).download("f", "got.bin", timeout=1)
    data = open("got.bin", "rb").read(); print("got", len(data), data == bytes(range(256)) * 40, f"{time.monotonic() - t0:.0f}")
    try: tftpy.TftpClient("10.0.0.1", 6969).download("none", "got2.bin", timeout=1)
    except tftpy.TftpShared.TftpException as e: print("failed", type(e).__name__)
