"""The kinds of faults: of the network, and of sensors, actuators and sea."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal

NetFaultKind = Literal["link", "down", "up", "partition", "mute", "deaf", "slow", "clock", "hold", "duplicate"]


class WorldFaultKind(StrEnum):
    """The effect of a fault of sensors, actuators or sea, and its numbers.

    | kind | values | what it does to a vehicle |
    |---|---|---|
    | noise | sigma of position [m], angle [rad], velocity [m/s], rate [rad/s] | white noise beside the sensor's own |
    | bias | twelve numbers on eta, nu, phi and p [m, rad, m/s, rad/s] | added to what is measured |
    | freeze | | the sensor repeats its measurement at the begin of the fault |
    | dropout | probability | that the sensor repeats its last measurement at a tick |
    | dvl | probability, bias on three axes [m/s, body], sigma [m/s], probability | samples lost, biased, jumping |
    | compass | probability, bias [rad], sigma [rad], probability | the same of the heading sensor |
    | fix | probability, bias north and east [m], sigma [m], probability | the same of fixes |
    | efficiency | three factors | multiply the force and moments that the actuators apply |
    | saturate | three limits [N, N m, N m] | in place of the actuators' own where they are smaller |
    | off | | the actuators apply no force |
    | stuck | | they keep their force at the begin of the fault |
    | current | x, y, z [m/s, NED], three sigma [m/s], time constant [s] | added to the sea's own, for every vehicle |
    | gust | x, y, z [m/s, NED], how long it blows [s] | a current that rises and falls once: (1 - cos) / 2 |
    | wrench | five forces and moments [N, N m, body] | added to the disturbance |
    | pause | | the agent is suspended: no samples; the vehicle holds its last command |
    | slow | ticks | commands take effect so much later |
    | clock | step [s], drift [s/s] | added to the clock of its agent, and of its modem |

    Pause and slow act on simulated time, not on a process.
    """

    NOISE = "noise"
    BIAS = "bias"
    FREEZE = "freeze"
    DROPOUT = "dropout"
    DVL = "dvl"
    COMPASS = "compass"
    FIX = "fix"
    EFFICIENCY = "efficiency"
    SATURATE = "saturate"
    OFF = "off"
    STUCK = "stuck"
    CURRENT = "current"
    GUST = "gust"
    WRENCH = "wrench"
    PAUSE = "pause"
    SLOW = "slow"
    CLOCK = "clock"

    @property
    def numbers(self) -> int:
        return _NUMBERS.get(self, 0)


_NUMBERS = {
    WorldFaultKind.NOISE: 4,
    WorldFaultKind.BIAS: 12,
    WorldFaultKind.DROPOUT: 1,
    WorldFaultKind.DVL: 6,
    WorldFaultKind.COMPASS: 4,
    WorldFaultKind.FIX: 5,
    WorldFaultKind.EFFICIENCY: 3,
    WorldFaultKind.SATURATE: 3,
    WorldFaultKind.CURRENT: 7,
    WorldFaultKind.GUST: 4,
    WorldFaultKind.WRENCH: 5,
    WorldFaultKind.SLOW: 1,
    WorldFaultKind.CLOCK: 2,
}
