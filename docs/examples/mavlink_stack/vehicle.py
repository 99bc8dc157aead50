"""A vehicle that speaks MAVLink over UDP: a heartbeat every second, and its parameters if somebody asks for them.

python vehicle.py PORT
"""

import sys
import time

from pymavlink import mavutil

PARAMETERS = {"ATC_ANG_PIT_P": 6.0, "ATC_ANG_YAW_P": 6.0, "PSC_POSZ_P": 3.0, "SURFACE_DEPTH": -10.0, "JS_GAIN_MAX": 1.0}
FLOAT = mavutil.mavlink.MAV_PARAM_TYPE_REAL32
WHAT = (mavutil.mavlink.MAV_TYPE_SUBMARINE, mavutil.mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)

link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{sys.argv[1]}", source_system=1)
names, beat_s = list(PARAMETERS), 0.0


def send(name: str) -> None:
    link.mav.param_value_send(name.encode(), PARAMETERS[name], FLOAT, len(names), names.index(name))


while True:
    if time.monotonic() - beat_s >= 1:
        beat_s = time.monotonic()
        link.mav.heartbeat_send(*WHAT, 0, 0, 0)
    message = link.recv_match(type=["PARAM_REQUEST_LIST", "PARAM_REQUEST_READ"], blocking=True, timeout=0.1)
    if message is None:
        continue
    for name in names if message.get_type() == "PARAM_REQUEST_LIST" else [names[message.param_index]]:
        send(name)
