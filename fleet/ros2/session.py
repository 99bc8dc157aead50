"""Where nodes of ROS 2 meet: the router to join, or to be."""

from __future__ import annotations

from fleet.errors import FleetError
from netem.errors import BusError
from netem.wire.listening import probe_address
from netem.wire.ros_bus import SESSION_FILE, SETTINGS, RosBus

HOST, PORT = "127.0.0.1", 7447  # where rmw_zenoh looks for its router


def open_ros_session(connect: str | None, listen: str | None) -> tuple[RosBus, str]:
    """A session: as asked, else as rmw_zenoh's variables say, else at the usual router of this host, hosted if need be.

    Args:
        connect: the endpoint of a router to join.
        listen: the endpoint of a router to be.

    Returns:
        the session, and in words what it is.

    Raises:
        FleetError: there is no router, or the endpoint is taken, or the settings are none.
    """
    try:
        if connect is not None:
            return _join(connect)
        if listen is not None:
            return RosBus.be_router(listen), f"a router at {listen}"
        if (bus := RosBus.as_configured()) is not None:
            return bus, f"as {SESSION_FILE} or {SETTINGS} say, {bus.endpoint or 'no endpoint'}"
        usual = f"tcp/{HOST}:{PORT}"
        try:
            probe_address(HOST, PORT)
        except OSError:
            return _join(usual)
        return RosBus.be_router(usual), f"a router at {usual}, this host only"
    except BusError as error:
        raise FleetError(str(error), status=3) from None


def _join(endpoint: str) -> tuple[RosBus, str]:
    try:
        return RosBus.join(endpoint), f"joined the router at {endpoint}"
    except BusError as error:
        raise FleetError(f"{error}; a router of ROS 2: ros2 run rmw_zenoh_cpp rmw_zenohd", status=3) from None
