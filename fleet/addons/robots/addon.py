"""What this add-on offers."""

from __future__ import annotations

from fleet.addon import AddOn, Verb

_AT = "fleet.addons.robots"
ADDON = AddOn(
    verbs={
        "Start": {"netem": Verb(f"{_AT}.verbs.netem:netem", "Put the network between programs of your own.")},
        "After a run": {"fit": Verb(f"{_AT}.verbs.fit:fit", "Fit link states to a trace of a link.")},
        "Other hosts and programs": {
            "record": Verb(f"{_AT}.verbs.record:record", "Record zenoh traffic to an MCAP file."),
            "ros2": Verb(f"{_AT}.verbs.ros2:ros2", "Show a live run or a log to ROS 2."),
        },
    },
    companions=(f"{_AT}.companion:Bridge",),
    exporters=(f"{_AT}.exporters:Traces", f"{_AT}.exporters:BagOfRos"),
    readers=(f"{_AT}.reader:RosBag",),
)
