"""The netem process: connects, and serves the network of a run in lockstep or on a wall clock."""

from __future__ import annotations

from netem.config import NetemConfig
from netem.process import NetemProcess
from netem.realtime_rounds import RealtimeRounds
from netem.rounds import Rounds
from netem.wire.access import Credentials
from netem.wire.bus import Bus, quiet_zenoh
from netem.wire.keys import Keys
from netem.wire.link_loss import end_with_link


def run(endpoint: str, run_id: str, credentials: Credentials, config: NetemConfig, real: bool) -> None:
    """Serve the network of a run until the process is ended; `real`: on a wall clock, not in lockstep."""
    quiet_zenoh()
    keys = Keys(run_id)
    bus = Bus.connect(endpoint, credentials)
    end_with_link(bus, credentials)
    _process(bus, keys, config, real).serve()


def _process(bus: Bus, keys: Keys, config: NetemConfig, real: bool) -> NetemProcess:
    if not real:
        return NetemProcess(bus, keys, config, Rounds(config))
    from netem.realtime_process import RealtimeNetemProcess  # which is one of these

    return RealtimeNetemProcess(bus, keys, config, RealtimeRounds(config))
