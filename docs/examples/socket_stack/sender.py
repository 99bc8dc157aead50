"""The shore's side of a stop-and-wait transfer over plain UDP: it repeats a block until it is acknowledged.

    python sender.py PORT BLOCKS

It ends with status 0 when the last block is acknowledged, and with 1 if a block was sent TRIES times in vain.
"""

import socket
import sys

PATIENCE_S, TRIES = 0.2, 20
PORT, BLOCKS = map(int, sys.argv[1:])

sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
sock.settimeout(PATIENCE_S)
for number in range(BLOCKS):
    for _ in range(TRIES):
        sock.sendto(number.to_bytes(4, "big") + bytes(200), ("127.0.0.1", PORT))
        try:
            while int.from_bytes(sock.recv(2048), "big") != number + 1:
                pass  # of a repeat before
        except TimeoutError:
            continue
        break
    else:
        sys.exit(f"block {number} was sent {TRIES} times in vain")
print(f"{BLOCKS} blocks are there")
