"""A robot's program that counts its messages, so that a recording shows what the network lost.

    python sender.py ROUTER KEY [PERIOD_S [COUNT]]
    python sender.py tcp/127.0.0.1:7511 auv1/status

It knows nothing of uuv-fleet. Each message is JSON with a number, and zenoh adds the time of sending.
"""

import json
import sys
import time
from itertools import count

import zenoh


def main(router: str, key: str, period_s: float = 0.1, most: int = 0) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([router]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    with zenoh.open(config) as session:
        out = session.declare_publisher(key, encoding="application/json")
        began = time.monotonic()
        for number in range(most) if most else count():
            out.put(json.dumps({"seq": number, "battery": 0.87}))
            time.sleep(max(0.0, began + (number + 1) * period_s - time.monotonic()))


if __name__ == "__main__":
    given = sys.argv[1:]
    main(given[0], given[1], *map(float, given[2:3]), *map(int, given[3:4]))
