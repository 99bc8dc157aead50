"""The process that publishes a live run's journal: from a pipe to zenoh, dropping what subscribers cannot take.

Started by `fleet.replay.publisher`. Stdin: one line of JSON, then batches as that module packs them;
stdout: one line of JSON when it listens, one at the first subscriber if that is waited for, one when it ends.
"""

from __future__ import annotations

import base64
import json
import os
import select
import signal
import sys
import time
import traceback
from typing import IO, Any

import setproctitle

from fleet.errors import RunBroken
from fleet.processes.ports import free_port
from fleet.replay.capture import zenoh_encoding
from fleet.replay.live_journal import pack_counts
from fleet.replay.observed import Observed, host_observed
from fleet.replay.publisher import ENTRY, LENGTH
from fleet.replay.topics import Stamp, hand_out, pack
from netem.errors import BusError
from netem.wire.keys import Keys
from netem.wire.session import quiet_zenoh

POLL_S = 0.02
SETTLE_S = 0.1  # a subscriber to several keys declares them one after another
NICE = 5  # the run comes first where there are fewer cores than processes


def main() -> None:
    code = 1
    try:
        _publish()
        code = 0
    except BrokenPipeError:
        code = 0  # the console was killed: there is no reader any more
    except BaseException:
        traceback.print_exc()
    finally:
        # At once: the interpreter's own way out joins zenoh's threads, and those wait for subscribers.
        os._exit(code)


def _publish() -> None:
    for number in (signal.SIGINT, signal.SIGHUP):  # what they mean is the console's business
        signal.signal(number, signal.SIG_IGN)
    quiet_zenoh()
    source = sys.stdin.buffer
    values = json.loads(source.readline())
    setproctitle.setproctitle(f"fleet publisher [{values['run']}]")
    try:
        endpoint = f"tcp/127.0.0.1:{free_port(None)}"
        bus = host_observed(Observed(endpoint, values["user"], values["password"], values["run"]))
    except (BusError, RunBroken) as error:
        _say({"error": str(error)})
        return
    keys = Keys(values["run"])
    schemas = {name: base64.b64decode(data) for name, data in values["schemas"].items()}
    topics = {topic: schema for _, topic, schema in values["channels"]}
    hand_out(bus, keys, topics, schemas, values["units"], values["scenario"])
    puts = {
        number: bus.publication(keys.log(topic), zenoh_encoding("protobuf", schema), drop=True)
        for number, topic, schema in values["channels"]
    }
    anybody = bus.publication(keys.log("**"), "zenoh/bytes", drop=True)
    end = bus.publication(keys.log_end, "zenoh/bytes", drop=False)
    os.nice(NICE)
    _say({"endpoint": endpoint})
    if values["wait"]:
        while not anybody.matched:
            # The console writes nothing before it knows; an end of the pipe is its own end.
            if select.select([source], [], [], POLL_S)[0]:
                return
        time.sleep(SETTLE_S)
        _say({"heard": True})
    published, counts = 0, dict.fromkeys(puts, 0)
    while (batch := _batch(source)) is not None:
        at = 0 if anybody.matched else len(batch)
        while at < len(batch):
            channel, sequence, log_ns, publish_ns, number, place, length = ENTRY.unpack_from(batch, at)
            at += ENTRY.size
            puts[channel].put(batch[at : at + length], pack(Stamp(log_ns, publish_ns, sequence, number)), place)
            at += length
            counts[channel] = place + 1
            published += 1
    _say({"published": published})
    if end.matched:
        end.put(pack_counts({topic: counts[number] for number, topic, _ in values["channels"]}), None)
    bus.close()  # sends what is queued, and waits for a subscriber that takes nothing; we are killed then


def _batch(source: IO[bytes]) -> bytes | None:
    """The next batch; None at the end, also when that comes in the middle of one."""
    head = source.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    (size,) = LENGTH.unpack(head)
    batch = source.read(size)
    return batch if len(batch) == size else None


def _say(values: dict[str, Any]) -> None:
    print(json.dumps(values), flush=True)
