"""Where the netem process starts: it connects, and serves the network of a run."""

from __future__ import annotations

from netem.clock import Clock
from netem.config import NetemConfig
from netem.process import NetemProcess
from netem.realtime_process import RealtimeNetemProcess
from netem.realtime_rounds import RealtimeRounds
from netem.rounds import Rounds
from netem.wire.bus import Bus
from netem.wire.credentials import Credentials, Members
from netem.wire.keys import Keys
from netem.wire.link_loss import end_with_link
from netem.wire.session import quiet_zenoh


def run(
    endpoint: str, run_id: str, credentials: Credentials, config: NetemConfig, clock: Clock, members: Members = ()
) -> None:
    """Serve the network of a run until the process is ended. `clock`: with `real`, ticks begin when the world says.
    `members`: the vehicles of each process that hosts several agents; in lockstep only. Raises BusError: there is no
    router at the endpoint, or it refuses the credentials."""
    quiet_zenoh()
    keys = Keys(run_id)
    bus = Bus.connect(endpoint, credentials, puts=[keys.rx("*"), keys.host("*")])
    end_with_link(bus, credentials)
    if clock is Clock.REAL:
        RealtimeNetemProcess(bus, keys, config, RealtimeRounds(config)).serve()
    else:
        NetemProcess(bus, keys, config, Rounds(config), members).serve()
