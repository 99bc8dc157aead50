# pyenet (ENet, a library of games): reliable and unreliable packets, agent 1 is the host.
import sys, time, enet
me = int(sys.argv[1]); t0 = time.monotonic()
host = enet.Host(enet.Address(b"10.0.0.1", 5050) if me == 1 else None, 4, 2, 0, 0)
if me == 2: time.sleep(1); peer = host.connect(enet.Address(b"10.0.0.1", 5050), 2)
k = 0
while time.monotonic() < t0 + 5.5:
    e = host.service(100)
    if e.type == enet.EVENT_TYPE_CONNECT: print("connected")
    if e.type == enet.EVENT_TYPE_DISCONNECT: print("disconnected")
    if e.type == enet.EVENT_TYPE_RECEIVE:
        print("heard", e.channelID, e.packet.data)
        if me == 1: e.peer.send(e.channelID, enet.Packet(b"back " + e.packet.data, enet.PACKET_FLAG_RELIABLE))
    if me == 2 and peer.state == enet.PEER_STATE_CONNECTED and time.monotonic() > t0 + 2 + 0.5 * k and k < 4:
        peer.send(k % 2, enet.Packet(b"%d" % k, enet.PACKET_FLAG_RELIABLE if k % 2 else 0)); k += 1
        if k == 4: host.flush()
    if me == 2 and time.monotonic() > t0 + 4.5: peer.disconnect()
print("done")
