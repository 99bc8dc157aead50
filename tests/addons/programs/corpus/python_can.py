# python-can: frames on a virtual bus over UDP multicast, with a notifier thread and a filter.
import sys, time, can
me = int(sys.argv[1]); t0 = time.time()
def heard(m): print(f"{m.timestamp - t0:.1f} heard {m.arbitration_id:#x} {m.data.hex()}")
with can.Bus(interface="udp_multicast", channel="239.74.163.2", fd=False, can_filters=[{"can_id": 0x100 + 3 - me, "can_mask": 0x7FF}]) as bus:
    notifier = can.Notifier(bus, [heard], timeout=0.2); time.sleep(0.95)
    for k in range(4): bus.send(can.Message(arbitration_id=0x100 + me, data=[me, k], is_extended_id=False)); time.sleep(1)
    notifier.stop()
print("done")
