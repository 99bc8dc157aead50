"""The methods that a class needs to be a plug-in, and the values that it may report."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import Any

from netem.parsing import nearest
from world.errors import PluginError
from world.plugins.error_place import place_of_method
from world.signal import Signal


def article(kind: str) -> str:
    """`a` or `an`, for the name of a kind of plug-in."""
    return "an" if kind[0] in "aeiou" else "a"


MAX_NUMBERS = 1000  # numbers of one signal, at most
_UNITLESS = "1"


def check_class(
    kind: str,
    name: str,
    plugin_class: Any,
    methods: Mapping[str, tuple[str, ...]],
    parameters: Mapping[str, Any],
    config: str,
) -> None:
    """Check that a class can be used as a plug-in of its kind.

    Args:
        kind: controller, plant, check, ...
        name: of the plug-in, for the message.
        plugin_class: the class that the name stands for.
        methods: the methods that it needs, and the arguments of each.
        parameters: its parameters, in addition to its configuration.
        config: describes its configuration, for the message.

    Raises:
        PluginError: it cannot.
    """
    if not inspect.isclass(plugin_class):
        raise PluginError(kind, name, f"expected a class, got {type(plugin_class).__name__}")
    for method, arguments in methods.items():
        if not callable(getattr(plugin_class, method, None)):
            hint = f"{article(kind)} {kind} needs {' and '.join(methods)}"
            raise PluginError(kind, name, f"it has no method {method}", hint)
        _check_method(kind, name, plugin_class, method, arguments)
    if abstract := sorted(getattr(plugin_class, "__abstractmethods__", ())):
        raise PluginError(kind, name, f"it is abstract: it lacks {', '.join(abstract)}")
    try:
        signature = inspect.signature(plugin_class)
    except ValueError:  # written in C: making it will show
        return
    try:
        signature.bind(None, **parameters)
    except TypeError as error:
        if "too many positional" in str(error):
            hint = f"write def __init__(self, config, ...): config is {config}"
            raise PluginError(kind, name, "it is made with its configuration, and takes none", hint) from None
        own = list(signature.parameters.values())[1:]
        shown = ", ".join(str(parameter.replace(annotation=inspect.Parameter.empty)) for parameter in own)
        hint = f"its parameters: {shown}" if shown else "it takes no parameters"
        names = [parameter.name for parameter in own]
        near = [word for key in parameters if key not in names and (word := nearest(key, names))]
        hint = " ".join([*near, hint])
        raise PluginError(kind, name, f"cannot be made with these parameters: {error}", hint) from None


def _check_method(kind: str, name: str, plugin_class: type[Any], method: str, arguments: tuple[str, ...]) -> None:
    function = inspect.getattr_static(plugin_class, method)
    if not inspect.isfunction(function):  # decorated, or written in C: calling it will show
        return
    place = place_of_method(function)
    if inspect.iscoroutinefunction(function) or inspect.isgeneratorfunction(function):
        raise PluginError(kind, name, f"its {method} must return its answer, not await or yield", place)
    try:
        inspect.signature(function).bind(None, *arguments)
    except TypeError as error:
        text = f"its {method} cannot be called as {method}({', '.join(arguments)}): {error}"
        raise PluginError(kind, name, text, place) from None


def check_signals(kind: str, name: str, signals: Any, taken: frozenset[str] = frozenset()) -> None:
    """Check that the declared signals can be logged.

    Args:
        kind: of the plug-in, for the message.
        name: of the plug-in, for the message.
        signals: declared by the class.
        taken: names that others use on the same topic.

    Raises:
        PluginError: they cannot.
    """
    if not isinstance(signals, tuple) or not all(isinstance(signal, Signal) for signal in signals):
        raise PluginError(
            kind, name, f"expected signals as a tuple of Signal, got {signals!r:.80}", "() reports nothing"
        )
    seen: dict[str, str] = {}  # name in JSON -> name
    for signal in signals:
        # As in protobuf, whose names are ASCII and differ also as JSON writes them: a_b is aB there.
        if not isinstance(signal.name, str) or not signal.name.isascii() or not signal.name.isidentifier():
            raise PluginError(kind, name, f"signal {signal.name!r} is not a name", "names are a-z, A-Z, digits and _")
        if signal.name in taken:
            hint = f"these are: {', '.join(sorted(taken))}"
            raise PluginError(kind, name, f"signal {signal.name!r} is reported already by every agent", hint)
        in_json = re.sub(r"_+(.?)", lambda match: match[1].upper(), signal.name)
        if seen.get(in_json) == signal.name:
            raise PluginError(kind, name, f"signal {signal.name!r} is declared twice")
        if in_json in seen:
            text = f"signals {seen[in_json]!r} and {signal.name!r} are both {in_json!r} in JSON"
            raise PluginError(kind, name, text, "rename one")
        if not isinstance(signal.unit, str) or not signal.unit:
            hint = f'write "{_UNITLESS}" for a number without'
            raise PluginError(kind, name, f"signal {signal.name!r} has no unit", hint)
        if not isinstance(signal.meaning, str):
            raise PluginError(kind, name, f"signal {signal.name!r} has meaning {signal.meaning!r:.80}, not a text")
        if not isinstance(signal.width, int) or not 1 <= signal.width <= MAX_NUMBERS:
            raise PluginError(kind, name, f"signal {signal.name!r} has width {signal.width!r}", f"1 to {MAX_NUMBERS}")
        seen[in_json] = signal.name
