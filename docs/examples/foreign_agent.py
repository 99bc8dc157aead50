"""An agent that needs nothing of uuv-fleet: `python foreign_agent.py join-3.json`, with `zenoh` and `msgpack` alone.

Written from docs/reference/protocol.md. Velocity in proportion to the consensus error, force and moments to what is
missing. It knows a line as reference, formations that stay, the full payload, and routers without TLS."""

import json
import math
import queue
import struct
import sys
import zlib
from pathlib import Path

import msgpack
import zenoh

STATE = struct.Struct("<BHQ6d")  # version, sender, tick, position, velocity; then a CRC-32
join = json.loads(Path(sys.argv[1]).read_text())
me, prefix = join["vehicle"], f"fleet/{join['run']}"
unicast = {"lowlatency": True, "qos": {"enabled": False}}
user = {"user": join["user"], "password": join["password"]}
transport = {"unicast": unicast, "link": {"tx": {"lease": 3_600_000}}, "auth": {"usrpwd": user}}
settings = {"mode": "client", "connect": {"endpoints": [join["endpoint"]]}, "transport": transport}
session = zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))
told = next((msgpack.unpackb(r.ok.payload.to_bytes()) for r in session.get(f"{prefix}/cfg/{me}") if r.ok), {})
if "agent" not in told:
    sys.exit(told.get("error", "the console did not answer"))
own, life, Ts = told["agent"], told["incarnation"], told["agent"]["tick_ns"] / 1e9
came = queue.SimpleQueue()
hold = [session.declare_subscriber(f"{prefix}/{k}/{me}", lambda s: came.put(s.payload)) for k in ("nav", "rx")]
block = zenoh.CongestionControl.BLOCK
cmd, tx = (session.declare_publisher(f"{prefix}/{k}/{me}", congestion_control=block).put for k in ("cmd", "tx"))


def take(timeout):
    """The next message for this life as [kind, incarnation, ...]; None for any other, or when there is none."""
    try:
        kind, *fields = msgpack.unpackb(came.get(timeout=timeout).to_bytes())
        sizes = {"nav": (4, 5, 6, 7), "rx": (4,), "end": (3,), "hello": (5,)}[kind]  # roll, clock, belief
        if len(fields) in sizes and (kind == "hello" or (fields[0] == life and isinstance(fields[1], int))):
            return [kind, *fields]
    except queue.Empty:
        if not session.info.routers_zid():
            sys.exit(session.close() or "the run is gone")
    except Exception as error:
        print(f"dropped a malformed message: {error!r}", file=sys.stderr)
    return None


def law(t, eta, nu, heard):
    """Surge force [N], pitch and yaw moment [N m]; and the own velocity over ground [m/s, NED]."""
    (theta, psi), (u, v, w, q, r) = eta[3:], nu
    ct, st, cp, sp = math.cos(theta), math.sin(theta), math.cos(psi), math.sin(psi)
    velocity = [cp * ct * u - sp * v + cp * st * w, sp * ct * u + cp * v + sp * st * w, ct * w - st * u]
    line, want = own["reference"], []
    for k in range(3):
        e = own["reference_weight"] * (eta[k] - line["start"][k] - line["velocity"][k] * t - own["offset"]["start"][k])
        for other in (other for other in own["neighbours"] if other["id"] in heard):
            sent, position, speed = heard[other["id"]]
            e += other["weight"] * (eta[k] - position[k] - speed[k] * (t - sent) - other["offset"]["start"][k])
        want.append(line["velocity"][k] - max(-0.5, min(0.5, 0.3 * e)))
    level, turn = abs(complex(*want[:2])), math.remainder(math.atan2(want[1], want[0]) - psi, math.tau)  # C: hypot
    tau = 40 * (level * math.cos(turn) - u), 15 * (math.atan2(-want[2], level) - theta) - 10 * q, 15 * turn - 10 * r
    return [float(max(-top, min(top, value))) for value, top in zip(tau, own["tau_max"])], velocity


try:
    echoed = set()
    while echoed != {"world", "netem"}:
        for put in (cmd, tx):
            put(msgpack.packb(["hello", "agent", me, life, join["version"], False]))
        while len(echoed) < 2 and (message := take(0.1)) and message[0] == "hello":
            echoed.add(message[1])
    cmd(msgpack.packb(["hello", "agent", me, life, join["version"], True]))
    token = session.liveliness().declare_token(f"{prefix}/alive/agent-{me}")
    known, nav, inbox, heard = told["begin"], None, [], {}
    while not (message := take(2.0)) or message[0] != "end":
        match message:
            case ["nav", _, tick, eta, nu, *_]:
                nav = tick
            case ["rx", _, until, more, deliveries]:
                inbox += deliveries
                known = known if more else until
        if nav is not None and (nav <= known or told.get("clock") == "real"):  # everything that was due by then is here
            for _, _, src, _, _, data, *_ in (delivery for delivery in inbox if delivery[0] <= tick):
                if len(data) == 63 and zlib.crc32(data[:-4]) == int.from_bytes(data[-4:], "little"):
                    _, _, sent, *numbers = STATE.unpack(data[:-4])
                    heard[src] = max(heard.get(src, (-1.0,)), (sent * Ts, numbers[:3], numbers[3:]))
            inbox = [delivery for delivery in inbox if delivery[0] > tick]
            tau, velocity = law(tick * Ts, eta, nu, heard)
            if tick % own["round_ticks"] == 0:
                state = STATE.pack(1, me, tick, *eta[:3], *velocity)
                tx(msgpack.packb(["tx", life, tick, [state + zlib.crc32(state).to_bytes(4, "little")]]))
            cmd(msgpack.packb(["cmd", life, tick, tau, []]))
            nav = None
except KeyboardInterrupt:  # it leaves the run; without that its token would stay, and the run would wait
    sys.exit(session.close() or 130)
session.close()
print(message[3])
