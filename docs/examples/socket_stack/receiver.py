"""The robot's side of a stop-and-wait transfer over plain UDP: it acknowledges each block, and prints how many it has.

python receiver.py PORT BLOCKS
"""

import socket
import sys

PORT, BLOCKS = map(int, sys.argv[1:])

sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
sock.bind(("127.0.0.1", PORT))
print("listens", flush=True)
wanted = 0
while True:
    data, sender = sock.recvfrom(2048)
    number = int.from_bytes(data[:4], "big")
    if number == wanted:  # older ones are repeats whose acknowledgement was lost
        wanted += 1
        print(f"has {wanted} of {BLOCKS}", flush=True)
    sock.sendto(wanted.to_bytes(4, "big"), sender)
