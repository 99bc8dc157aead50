"""Rights on the router: one generated user per process, and the access-control list.

The router *enforces* the graph's isolation. Agent i can put tx/i, cmd/i and its own notes, hold its token, ask for
cfg/i, and receive rx/i and nav/i. The router refuses everything else. The world process is the router itself, so its
own session is not subject to the list.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

from netem.wire.keys import Keys

CONSOLE, NETEM, OPERATOR, WORLD = "console", "netem", "operator", "world"
OBSERVER = "observer"  # a published run has a router of its own, where the observer may read the journal


Members = Sequence[Sequence[int]]  # the vehicles whose agents share a process, by host: host 1 comes first


def agent_role(i: int) -> str:
    """The user name and token name of agent i."""
    return f"agent-{i}"


def host_role(h: int) -> str:
    """The user name of host h, a process of several agents."""
    return f"host-{h}"


LEASE_MS = 3_600_000  # between processes of one host
Grant = tuple[str, list[str], list[str]]  # flow, messages, key expressions


@dataclass(frozen=True, slots=True)
class Credentials:
    """The login of one process; its secrets never reach argv, a log or a repr."""

    user: str
    password: str
    ca: str = ""  # PEM: with TLS, whose certificates the router may show
    certificate: str = ""  # PEM, with its key: what this process shows a router that asks for certificates
    key: str = ""
    lease_ms: int = LEASE_MS  # how long the router keeps this process's session without a sign of life

    def __repr__(self) -> str:
        return f"Credentials(user={self.user!r}, ***)"

    def to_values(self) -> dict[str, Any]:
        """The content of this process's file: user, password, and every other field that differs from its default."""
        return {each.name: value for each in fields(self) if (value := getattr(self, each.name)) != each.default}

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> Credentials:
        """Read such a file; other entries are ignored.

        Raises:
            TypeError: there is no user or no password.
        """
        return cls(**{each.name: values[each.name] for each in fields(cls) if each.name in values})


@dataclass(frozen=True, slots=True)
class Listener:
    """Where the router listens for others, on this host or elsewhere, besides the socket of the run's own processes."""

    endpoints: tuple[str, ...]
    lease_ms: int
    ca: str = ""  # PEM, as are the others: needed for tls endpoints only
    certificate: str = ""
    key: str = field(default="", repr=False)
    certified: frozenset[str] = frozenset()  # who must show a client certificate of that name, if any does


def generate(
    vehicles: tuple[int, ...], *, hosts: Members = (), prefix: str = "", world: bool = False
) -> dict[str, Credentials]:
    """Make fresh credentials for every client of a run.

    Args:
        vehicles: as for `access_control`.
        hosts: likewise.
        prefix: likewise.
        world: likewise.

    Returns:
        The credentials, by role.
    """
    roles = [CONSOLE, NETEM, OPERATOR, *map(agent_role, _alone(vehicles, hosts)), *([WORLD] if world else [])]
    roles += [host_role(h) for h in range(1, len(hosts) + 1)]
    return {role: Credentials(prefix + role, secrets.token_urlsafe(24)) for role in roles}


def access_control(
    keys: Keys,
    vehicles: tuple[int, ...],
    *,
    hosts: Members = (),
    certified: Mapping[str, Sequence[str]] = MappingProxyType({}),
    prefix: str = "",
    world: bool = False,
) -> dict[str, Any]:
    """Zenoh's `access_control` block for one run: deny by default, then what each role needs.

    Args:
        hosts: the agents that share processes. They use the login of their host, in every life. One login per agent
            would be slow: the router looks through the lists of all logins at each login (1,000 lists: 3 ms).
        certified: roles that must also show a client certificate, each with the common names that are allowed.
        prefix: the user names and the names of the rules begin with it, if several runs share a router.
        world: the world is a client of the router, too.
    """
    listed = _List(prefix)

    def allow(role: str, *grants: Grant) -> None:
        subject: dict[str, Any] = {"usernames": [prefix + role]}
        if role in certified:
            subject["cert_common_names"] = [*certified[role]]
        listed.allow(role, subject, *grants)

    for i in _alone(vehicles, hosts):
        allow(agent_role(i), *_agent_grants(keys, i))
    for h, members in enumerate(hosts, start=1):
        allow(host_role(h), *_host_grants(keys, h, members))
    allow(NETEM, *_netem_grants(keys))
    allow(CONSOLE, *_console_grants(keys))
    allow(OPERATOR, *_operator_grants(keys))
    if world:
        allow(WORLD, *_world_grants(keys))
    return listed.values()


def _alone(vehicles: Sequence[int], hosts: Members) -> list[int]:
    hosted = {i for members in hosts for i in members}
    return [i for i in vehicles if i not in hosted]


def certificate_control(keys: Keys, vehicles: tuple[int, ...]) -> dict[str, Any]:
    """The list for the router of agents without a password: a certificate's common name says which agent it is."""
    listed = _List()
    for i in vehicles:
        role = agent_role(i)
        subscribed = ("egress", ["declare_subscriber"], [keys.every(i)])  # there tx and cmd are one subscription
        listed.allow(role, {"cert_common_names": [role]}, *_agent_grants(keys, i), subscribed)
    return listed.values()


def observer_control(keys: Keys) -> dict[str, Any]:
    """The list for the router of a published run: the observer may listen to the journal, ask for topics, schemas,
    units and the scenario, and put nothing."""
    heard = [keys.log("**"), keys.log_end]
    asked = [keys.topics, keys.schema("**"), keys.units, keys.scenario]
    listed = _List()
    listed.allow(
        OBSERVER,
        {"usernames": [OBSERVER]},
        ("ingress", ["declare_subscriber"], heard),
        ("egress", ["put"], heard),
        ("ingress", ["query"], asked),
        ("egress", ["reply", "declare_queryable"], asked),
    )
    return listed.values()


def _netem_grants(keys: Keys) -> tuple[Grant, ...]:
    return (
        ("ingress", ["put"], [keys.rx("*"), keys.host("*"), keys.links, keys.note(NETEM)]),
        ("ingress", ["declare_subscriber"], [keys.tx("*")]),
        ("ingress", ["declare_queryable", "reply"], [keys.ctl(NETEM)]),
        ("ingress", ["liveliness_token"], [keys.alive(NETEM)]),
        ("egress", ["put"], [keys.tx("*")]),
        ("egress", ["query"], [keys.ctl(NETEM)]),
        ("egress", ["declare_subscriber"], [keys.rx("*"), keys.host("*"), keys.links, keys.note("*")]),
    )


def _console_grants(keys: Keys) -> tuple[Grant, ...]:
    return (
        ("ingress", ["put"], [keys.grant, f"{keys.prefix}/log/**"]),
        ("ingress", ["declare_subscriber"], [keys.frame, keys.links, keys.note("*")]),
        ("ingress", ["query"], [f"{keys.prefix}/ctl/**"]),
        ("ingress", ["declare_queryable", "reply"], [keys.cfg("*"), f"{keys.op}/**"]),
        ("ingress", ["liveliness_token"], [keys.alive(CONSOLE)]),
        ("ingress", ["declare_liveliness_subscriber", "liveliness_query"], [keys.alive("*")]),
        ("egress", ["put"], [keys.frame, keys.links, keys.note("*")]),
        ("egress", ["query"], [keys.cfg("*"), f"{keys.op}/**"]),
        ("egress", ["reply"], [f"{keys.prefix}/ctl/**"]),
        ("egress", ["declare_subscriber"], [keys.cmd("*"), f"{keys.prefix}/log/**"]),
        ("egress", ["declare_queryable"], [f"{keys.prefix}/ctl/**"]),
        ("egress", ["liveliness_token"], [keys.alive("*")]),
    )


def _operator_grants(keys: Keys) -> tuple[Grant, ...]:
    return (
        ("ingress", ["query"], [f"{keys.op}/**"]),
        ("ingress", ["declare_subscriber"], [f"{keys.prefix}/log/**"]),
        ("egress", ["reply"], [f"{keys.op}/**"]),
        ("egress", ["declare_queryable"], [f"{keys.op}/**"]),
        ("egress", ["put"], [f"{keys.prefix}/log/**"]),
    )


def _world_grants(keys: Keys) -> tuple[Grant, ...]:
    return (
        ("ingress", ["put"], [keys.nav("*"), keys.round, keys.frame, keys.note(WORLD)]),
        ("ingress", ["declare_subscriber"], [keys.cmd("*")]),
        ("ingress", ["declare_queryable", "reply"], [keys.ctl(WORLD)]),
        ("ingress", ["liveliness_token"], [keys.alive(WORLD)]),
        ("ingress", ["declare_liveliness_subscriber", "liveliness_query"], [keys.alive("*")]),
        ("egress", ["put"], [keys.cmd("*")]),
        ("egress", ["query"], [keys.ctl(WORLD)]),
        ("egress", ["declare_subscriber"], [keys.nav("*"), keys.tx("*"), keys.frame, keys.note("*")]),
        ("egress", ["liveliness_token"], [keys.alive("*")]),
    )


def _agent_grants(keys: Keys, i: int) -> list[Grant]:
    role = agent_role(i)
    return [
        ("ingress", ["put"], [keys.tx(i), keys.cmd(i), keys.note(role)]),
        ("ingress", ["declare_subscriber"], [keys.rx(i), keys.nav(i)]),
        ("ingress", ["query"], [keys.cfg(i)]),
        ("ingress", ["liveliness_token"], [keys.alive(role)]),
        ("egress", ["put"], [keys.rx(i), keys.nav(i)]),
        ("egress", ["reply"], [keys.cfg(i)]),
        # Not `cmd/3` alone: on a router with access control a publisher stays silent until it hears of a subscriber,
        # and it hears the subscriber's expression, which has a star.
        ("egress", ["declare_subscriber"], [keys.tx("*"), keys.cmd("*"), keys.note("*")]),
        ("egress", ["declare_queryable"], [keys.cfg("*")]),
    ]


def _host_grants(keys: Keys, h: int, members: Sequence[int]) -> list[Grant]:
    """The rights of a host: those of its agents, for their later lives, and the keys that carry messages of all, for
    the first.
    """
    role = host_role(h)
    grants: list[Grant] = [
        ("ingress", ["put"], [keys.tx(role), keys.cmd(role), keys.note(role)]),
        ("ingress", ["declare_subscriber"], [keys.host(h)]),
        ("ingress", ["query"], [keys.cfg(role)]),
        ("ingress", ["liveliness_token"], [keys.alive(role)]),
        ("egress", ["put"], [keys.host(h)]),
        ("egress", ["reply"], [keys.cfg(role)]),
    ]
    allowed: dict[tuple[str, ...], dict[str, None]] = {}
    for flow, messages, expressions in (*grants, *(grant for i in members for grant in _agent_grants(keys, i))):
        allowed.setdefault((flow, *messages), {}).update(dict.fromkeys(expressions))
    return [(flow, messages, [*expressions]) for (flow, *messages), expressions in allowed.items()]


class _List:
    """Zenoh's `access_control` block: deny by default, and what is allowed."""

    def __init__(self, prefix: str = "") -> None:
        self._prefix = prefix
        self._rules: list[dict[str, Any]] = []
        self._policies: list[dict[str, Any]] = []
        self._subjects: list[dict[str, Any]] = []

    def allow(self, role: str, subject: dict[str, Any], *grants: Grant) -> None:
        names = [f"{self._prefix}{role}:{number}" for number in range(len(grants))]
        for name, (flow, messages, key_exprs) in zip(names, grants, strict=True):
            self._rules.append(
                {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": key_exprs}
            )
        self._subjects.append({"id": self._prefix + role} | subject)
        self._policies.append({"rules": names, "subjects": [self._prefix + role]})

    def values(self) -> dict[str, Any]:
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": self._rules,
            "subjects": self._subjects,
            "policies": self._policies,
        }
