"""What this add-on offers."""

from __future__ import annotations

from fleet.addon import AddOn, Verb

_VERBS = "fleet.addons.hosts.verbs"
ADDON = AddOn(
    verbs={
        "Other hosts and programs": {
            "agent": Verb(f"{_VERBS}.protocol:agent", "Run an external vehicle's agent in this terminal."),
            "hosts": Verb(f"{_VERBS}.hosts:hosts", "Prepare a run over several hosts: certificates, a router."),
            "protocol": Verb(f"{_VERBS}.protocol:protocol", "Print the wire protocol, or check an agent."),
        }
    },
    companions=("fleet.addons.hosts.companion:Hosts",),
    hints={"acl": "fleet hosts acl", "certs": "fleet hosts certs"},
)
