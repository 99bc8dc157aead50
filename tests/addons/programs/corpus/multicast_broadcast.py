# Plain sockets: three agents in a multicast group and on the broadcast address, with loopback off.
import socket, struct, sys, time
me = int(sys.argv[1]); t0 = time.monotonic()
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1); s.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
s.bind(("", 5008))
s.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton("239.1.2.3") + socket.inet_aton(f"10.0.0.{me}"))
s.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 0); s.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
s.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(f"10.0.0.{me}"))
s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", 0, 200000))
print("interfaces", sorted(x[1] for x in socket.if_nameindex())[-1] != "")
due = t0 + 0.65 + 0.3 * me; k = 0
while time.monotonic() < t0 + 5:
    if time.monotonic() >= due and k < 3:
        s.sendto(b"group %d of %d" % (k, me), ("239.1.2.3", 5008)); s.sendto(b"all %d of %d" % (k, me), ("10.0.0.255", 5008)); due += 1; k += 1
    try: data, a = s.recvfrom(1000)
    except BlockingIOError: continue
    if a[0] != f"10.0.0.{me}": print(f"{time.monotonic() - t0:.0f}", data.decode(), a[0])
print("done")
