"""Who may do what on the router: one generated user per process, and the access-control list.

The router *enforces* the graph's isolation: agent i can put tx/i, cmd/i and its own notes, hold its token,
ask for cfg/i, and receive rx/i and nav/i; nothing else. The world process is the router itself, so its own
session is not subject to the list.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from typing import Any

from netem.keys import Keys

CONSOLE, NETEM, OPERATOR = "console", "netem", "operator"
OBSERVER = "observer"  # of a published run: it has a router of its own, and may read the journal there


def agent_role(i: int) -> str:
    """The user name and token name of agent i."""
    return f"agent-{i}"


@dataclass(frozen=True, slots=True)
class Credentials:
    """User and password of one process; the password never reaches argv, a log or a repr."""

    user: str
    password: str

    def __repr__(self) -> str:
        return f"Credentials(user={self.user!r}, password=***)"


def generate(vehicles: tuple[int, ...]) -> dict[str, Credentials]:
    """Fresh credentials for every client of a run, by role."""
    roles = [CONSOLE, NETEM, OPERATOR, *(agent_role(i) for i in vehicles)]
    return {role: Credentials(role, secrets.token_urlsafe(24)) for role in roles}


def access_control(keys: Keys, vehicles: tuple[int, ...]) -> dict[str, Any]:
    """Zenoh's `access_control` block for one run: deny by default, then what each role needs."""
    rules: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []

    def allow(role: str, *grants: tuple[str, list[str], list[str]]) -> None:
        names = []
        for number, (flow, messages, key_exprs) in enumerate(grants):
            name = f"{role}:{number}"
            rules.append(
                {
                    "id": name,
                    "permission": "allow",
                    "flows": [flow],
                    "messages": messages,
                    "key_exprs": key_exprs,
                }
            )
            names.append(name)
        subjects.append({"id": role, "usernames": [role]})
        policies.append({"rules": names, "subjects": [role]})

    for i in vehicles:
        role = agent_role(i)
        allow(
            role,
            ("ingress", ["put"], [keys.tx(i), keys.cmd(i), keys.note(role)]),
            ("ingress", ["declare_subscriber"], [keys.rx(i), keys.nav(i)]),
            ("ingress", ["query"], [keys.cfg(i)]),
            ("ingress", ["liveliness_token"], [keys.alive(role)]),
            ("egress", ["put"], [keys.rx(i), keys.nav(i)]),
            ("egress", ["reply"], [keys.cfg(i)]),
            # The router tells a publisher which key expressions are subscribed to; ours are the starred
            # ones, and a publisher that hears of none stays silent.
            ("egress", ["declare_subscriber"], [keys.tx("*"), keys.cmd("*"), keys.note("*")]),
            ("egress", ["declare_queryable"], [keys.cfg("*")]),
        )
    allow(
        NETEM,
        ("ingress", ["put"], [keys.rx("*"), keys.links, keys.note(NETEM)]),
        ("ingress", ["declare_subscriber"], [keys.tx("*"), keys.round]),
        ("ingress", ["declare_queryable", "reply"], [keys.ctl(NETEM)]),
        ("ingress", ["liveliness_token"], [keys.alive(NETEM)]),
        ("egress", ["put"], [keys.tx("*"), keys.round]),
        ("egress", ["query"], [keys.ctl(NETEM)]),
        ("egress", ["declare_subscriber"], [keys.rx("*"), keys.links, keys.note("*")]),
    )
    allow(
        CONSOLE,
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
    allow(
        OPERATOR,
        ("ingress", ["query"], [f"{keys.op}/**"]),
        ("ingress", ["declare_subscriber"], [f"{keys.prefix}/log/**"]),
        ("egress", ["reply"], [f"{keys.op}/**"]),
        ("egress", ["declare_queryable"], [f"{keys.op}/**"]),
        ("egress", ["put"], [f"{keys.prefix}/log/**"]),
    )
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def observer_control(keys: Keys) -> dict[str, Any]:
    """The list for the router of a published run: the observer may listen to the journal and ask for schemas, and
    put nothing."""
    log, schemas = keys.log("**"), keys.schema("**")
    grants = [
        ("ingress", ["declare_subscriber"], log),
        ("egress", ["put"], log),
        ("ingress", ["query"], schemas),
        ("egress", ["reply", "declare_queryable"], schemas),
    ]
    rules = [
        {"id": f"{OBSERVER}:{n}", "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": [key]}
        for n, (flow, messages, key) in enumerate(grants)
    ]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": OBSERVER, "usernames": [OBSERVER]}],
        "policies": [{"rules": [rule["id"] for rule in rules], "subjects": [OBSERVER]}],
    }
