"""The signals that the checks of a scenario are about, so that pictures show them without being asked."""

from __future__ import annotations

from collections.abc import Iterable

from fleet.scenario.schema.checks import ChecksSection
from fleet.scenario.sections.signals import OF_THE_LAWS, OF_THE_PLANT, SignalName, parse_name

_HAVE_A_PICTURE = ("error.e_norm", "error.formation_norm")  # of their own, everywhere


def checked_signals(checks: ChecksSection, looked_at: Iterable[str] = ()) -> list[SignalName]:
    """The signals that checks name or looked at, in their order, without the errors that are always drawn.

    Args:
        checks: of the scenario.
        looked_at: signals that judged checks looked at. Only what laws and plants report counts there, since a check
            in Python may look at everything else.
    """
    texts = [check.topic for check in checks.signal or ()]
    texts += [text for text in looked_at if text.partition(".")[0] in (*OF_THE_LAWS, OF_THE_PLANT)]
    names = (parse_name(text) for text in dict.fromkeys(texts))
    return [name for name in names if name is not None and name.name not in _HAVE_A_PICTURE]
