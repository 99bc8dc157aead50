"""The rule that a plug-in exists, may run, and can be used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from fleet.scenario.parts import Parts
from fleet.scenario.rules.report import Report
from netem.parsing import nearest
from world.errors import PluginError, UntrustedError


def plugin(
    parts: Parts,
    report: Report,
    at: tuple[str, ...],
    kind: str,
    name: str,
    shipped: Sequence[str],
    load: Callable[[], Any],
) -> bool:
    """Report the mistakes of a plug-in; whether it can be used, as far as that is known.

    One that may not be imported now is left out. `load` loads and checks its class, and raises PluginError.
    """
    typed = report.typed(at)
    if not (name in shipped or typed or report.policy.imports):
        return True
    try:
        if name not in shipped:
            report.policy.admit(kind, name, parts.folder, typed=typed)
        load()
    except UntrustedError as error:
        report.refuse(at, f"{name}: {error.problem}", error.hint)
    except PluginError as error:
        if not typed and report.policy.of_a_log:  # the log is from elsewhere, and its modules are not here
            report.refuse(at, f"{name}: {error.problem}", error.hint)
        elif name not in shipped and ":" not in name and "does not load" not in error.problem:
            close = nearest(name, shipped) if shipped else ""
            known = f"known: {', '.join(shipped)}, or" if shipped else "write"
            report.add(at, f'there is no {kind} "{name}"', close or f"{known} package.module:Class")
        else:
            report.add(at, f"{name}: {error.problem}", error.hint)
    else:
        return True
    return False
