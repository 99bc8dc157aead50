# pymavlink: agent 2 is a vehicle with heartbeats, agent 1 a ground station that pings it.
import os, sys, time
os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil
me = int(sys.argv[1]); t0 = time.monotonic()
if me == 1:
    link = mavutil.mavlink_connection("udpin:0.0.0.0:14550", source_system=255)
    link.wait_heartbeat(timeout=5); print("heartbeat of", link.target_system)
    for k in range(4):
        link.mav.ping_send(int(time.time() * 1e6), k, link.target_system, 0)
        m = link.recv_match(type="PING", blocking=True, timeout=1)
        print("ping", k, m and f"{time.time() - m.time_usec / 1e6:.1f}"); time.sleep(0.5)
else:
    link = mavutil.mavlink_connection("udpout:10.0.0.1:14550", source_system=me); due = t0 + 0.5
    while time.monotonic() < t0 + 6:
        if time.monotonic() >= due: due += 1; link.mav.heartbeat_send(2, 3, 0, 0, 0)
        m = link.recv_match(type="PING", blocking=True, timeout=0.1)
        if m: link.mav.ping_send(m.time_usec, m.seq, m.get_srcSystem(), 0); print("answers", m.seq)
