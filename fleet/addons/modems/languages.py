"""A modem by what a file says of it: its language, where programs open it, its address."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from fleet.addons.modems.evologics import EvoLogics
from fleet.addons.modems.micromodem import MicroModem
from fleet.addons.modems.modem import ModemCore, ModemLanguage
from fleet.addons.modems.unet import Unet
from fleet.scenario.schema.nodes import ModemPortSection

_LANGUAGES: dict[str, type[ModemLanguage]] = {"unet": Unet, "evologics": EvoLogics, "micromodem": MicroModem}


def modem_core(number: int, section: ModemPortSection) -> ModemCore:
    """The modem of a robot, which is not open yet. `number`: of the robot."""
    language: Callable[[], ModemLanguage] = _LANGUAGES[section.language]
    if section.language == "evologics":
        language = partial(EvoLogics, section.mode or "data", section.usbl)
    if isinstance(where := section.where, str):
        return ModemCore(number, language, terminal=where, address=section.address)
    return ModemCore(number, language, where or 0, section.host, address=section.address)
