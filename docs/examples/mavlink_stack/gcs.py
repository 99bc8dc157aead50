"""A ground station that reads all parameters of a vehicle over UDP, and asks again for each that is missing.

    python gcs.py PORT

It ends with status 0 when it has all, and with 1 after 20 questions.
"""

import sys

from pymavlink import mavutil

PATIENCE_S, MOST = 0.5, 20

link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{sys.argv[1]}", source_system=255)
print("listens", flush=True)
link.wait_heartbeat()
found, of = {}, None
for _ in range(MOST):
    if of is None:
        link.mav.param_request_list_send(1, 1)
    else:
        link.mav.param_request_read_send(1, 1, b"", next(i for i in range(of) if i not in found))
    while (message := link.recv_match(type="PARAM_VALUE", blocking=True, timeout=PATIENCE_S)) is not None:
        of = message.param_count
        found[message.param_index] = message.param_value
        print(f"has {len(found)} of {of}", flush=True)
        if len(found) == of:
            sys.exit()
sys.exit(f"has {len(found)} of {of} after {MOST} questions")
