"""A vehicle whose agent is a real computer: how its programs take part, and what starts them."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import BeforeValidator, model_validator

from fleet.quantities import describe_value
from fleet.scenario.schema.nodes import ModemPortSection
from fleet.scenario.schema.programs import Words
from fleet.scenario.value_types import Section, mistake

_WAY = re.compile(r"\d{1,5}=[^\s:=]+:\d{1,5}", re.ASCII)


def _ways(value: Any) -> Any:
    if isinstance(value, dict):
        for port, where in value.items():
            if not _WAY.fullmatch(f"{port}={where}"):
                raise mistake(f"expected a port and where its program is, got {describe_value({port: where})}",
                              hint='{"9000": "192.168.0.7:9100"}')  # fmt: skip
        return {str(port): where for port, where in value.items()}
    return value


class GatewaySection(Section):
    """What `fleet agent` is told that stands for a real computer. One of zenoh, udp and modem is given."""

    zenoh: str | None = None  # where its programs connect, as zenoh writes it: tcp/0.0.0.0:7501
    carry: list[str] = []  # with zenoh: key expressions of what leaves
    udp: Annotated[dict[str, str], BeforeValidator(_ways)] = {}  # "9000": "192.168.0.7:9100"
    modem: ModemPortSection | None = None  # that its programs open here
    run: Words | None = None  # what starts its program anew with each run, such as [ssh, auv, ./start.sh]

    @model_validator(mode="after")
    def _whole(self) -> GatewaySection:
        if not (self.zenoh or self.udp or self.modem):
            raise mistake("expected zenoh, udp or modem: how its programs take part", hint="zenoh: tcp/0.0.0.0:7501")
        if self.carry and not self.zenoh:
            raise mistake("carry has no effect without zenoh")
        return self
