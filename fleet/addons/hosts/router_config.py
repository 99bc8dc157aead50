"""The configuration of a zenoh router that is there already: it admits one run, each role with its rights only."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from fleet.addons.hosts.certificates import CA, OWN, SERVER, path
from fleet.addons.hosts.rendezvous import new_credentials
from fleet.errors import FleetError
from netem.whole_file import write_whole
from netem.wire.credentials import CONSOLE, NETEM, OPERATOR, WORLD, access_control, agent_role
from netem.wire.keys import Keys
from netem.wire.session import router_settings

CONFIG, USERS, CREDENTIALS = "router.json5", "users", "credentials.json"


def config(run: str, vehicles: int, listen: str, users: str, certs: Path | None, *, mutual: bool, lease_ms: int) -> str:
    """The text of a configuration file for zenohd. It names the file of passwords, and contains none.

    Args:
        users: path of the file of users and passwords on the router's host.
        certs: for tls, the directory of the router's certificate on the router's host.
        mutual: clients must show certificates. An agent shows its own certificate, or that of the run's host. Every
            other process shows that of the run's host.
    """
    numbers = tuple(range(1, vehicles + 1))
    values: dict[str, Any] = {"mode": "router", "listen": {"endpoints": [listen], "exit_on_failure": True}}
    for name, value in router_settings(vehicles, lease_ms).items():
        _put(values, name, value)
    _put(values, "transport/auth/usrpwd/dictionary_file", users)
    if certs is not None:
        tls = "transport/link/tls"
        _put(values, f"{tls}/root_ca_certificate", str(path(certs, CA)))
        _put(values, f"{tls}/listen_certificate", str(path(certs, SERVER)))
        _put(values, f"{tls}/listen_private_key", str(path(certs, SERVER, key=True)))
        _put(values, f"{tls}/enable_mtls", mutual)
    certified = {role: [OWN] for role in (CONSOLE, NETEM, OPERATOR, WORLD)}
    certified |= {role: [OWN, role] for role in map(agent_role, numbers)}  # the run's own, or from elsewhere
    control = access_control(Keys(run), numbers, certified=certified if mutual else {}, prefix=f"{run}-", world=True)
    values["access_control"] = control
    head = (
        f"// A zenoh router for run {run} of uuv-fleet, {vehicles} vehicles: zenohd -c {CONFIG}\n"
        "// In a router that serves others, too, merge the three lists of access_control into its own, and the users\n"
        "// into its file of users. Everything that no rule allows is denied.\n"
    )
    return head + json.dumps(values, indent=2) + "\n"


def write(directory: Path, run: str, vehicles: int, text: str, *, force: bool = False) -> None:
    """Write the configuration, the router's file of users, and the credentials file for `fleet run`.

    Raises FleetError: files are in the way, or the directory cannot be written.
    """
    credentials = new_credentials(run, vehicles)
    users = "".join(f"{user}:{password}\n" for user, password in credentials["users"].values())
    there = [name for name in (CONFIG, USERS, CREDENTIALS) if (directory / name).exists()]
    if there and not force:
        raise FleetError(
            f"{directory} holds {', '.join(there)} already; --force replaces them, and then the router needs the new "
            "ones, too; or choose another directory"
        )
    try:
        if not directory.exists():
            directory.mkdir(mode=0o700, parents=True)
        write_whole(directory / CONFIG, text.encode(), 0o644)
        write_whole(directory / USERS, users.encode())
        write_whole(directory / CREDENTIALS, (json.dumps(credentials, indent=2) + "\n").encode())
    except OSError as error:
        raise FleetError(f"{directory} cannot be written: {error.strerror}") from None


def _put(values: dict[str, Any], name: str, value: Any) -> None:
    *parents, last = name.split("/")
    for parent in parents:
        values = values.setdefault(parent, {})
    values[last] = value
