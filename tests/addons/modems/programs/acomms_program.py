"""A script with WHOI's own client: a ping, a packet that is acknowledged, a mini packet. It knows nothing of us."""

import json
import sys
import time
import warnings
from datetime import datetime

warnings.simplefilter("ignore")

from acomms.micromodem import Micromodem  # noqa: E402

WAIT_S = 60
one, two = (Micromodem(name, log_path=sys.argv[3]) for name in ("one", "two"))
one.connect(sys.argv[1])
two.connect(sys.argv[2])
deadline = time.monotonic() + WAIT_S
while (one.id, two.id) != (1, 2) and time.monotonic() < deadline:
    time.sleep(0.1)
found = {"ids": [one.id, two.id]}
one.send_ping(2)
found["travel_s"] = one.wait_for_ping_reply(2, timeout=WAIT_S)
one.send_packet_data(2, bytearray(b"hello from the auv"), rate_num=1, ack=True)
found["acknowledged"] = one.wait_for_nmea_type("CAACK", timeout=WAIT_S)["params"]
one.write_nmea({"type": "CCMUC", "params": [1, 2, "1ABC"]})
found["mini"] = two.wait_for_nmea_type("CAMUA", timeout=WAIT_S)["params"]
clock = datetime(2031, 2, 3, 4, 5, 6)
one.set_time(clock)
found["behind_s"] = (one.get_time().replace(tzinfo=None) - clock).total_seconds()
print(json.dumps(found))
