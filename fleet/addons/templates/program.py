"""Programs that agree on the greatest number among them, over zenoh. This one knows nothing of uuv-fleet.

    python the_law.py ROUTER NUMBER
    python the_law.py tcp/127.0.0.1:7601 1

Each begins with ten times its number, puts what it knows twice a second, and prints the time and the greatest number
that it has heard of. It runs as it is in lockstep (fleet run the_law.yaml) and on the wall clock (fleet netem
the_law_stack.yaml, and a program for each node).
"""

import json
import sys
import threading
import time

import zenoh


class TheLaw:
    """What one program knows."""

    def __init__(self, number: int) -> None:
        self.best = 10 * number
        self.lock = threading.Lock()

    def heard(self, sample: zenoh.Sample) -> None:
        with self.lock:
            self.best = max(self.best, int(sample.payload.to_string()))


def main(router: str, number: int) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([router]))
    config.insert_json5("scouting/multicast/enabled", "false")
    program = TheLaw(number)
    with zenoh.open(config) as session:
        publisher = session.declare_publisher(f"fleet/{number}/best")
        session.declare_subscriber("fleet/*/best", program.heard)
        while True:
            with program.lock:
                best = program.best
            publisher.put(str(best))
            print(f"{time.monotonic():.3f} {best}", flush=True)
            time.sleep(0.5)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(sys.argv[1], int(sys.argv[2]))
