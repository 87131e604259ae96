"""What a shell offers on TAB that only a running bridge knows: its topics, clients and parameters.

Whatever goes wrong, nothing is offered: a shell that completes has no place for a message, and does not wait.
"""

from __future__ import annotations

import threading
from argparse import Namespace
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

from msgspec.structs import fields

from rsb_bridge.config.file_form import KEYS, NAME_KEYS
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.qos import AUTO, PROFILES
from rsb_bridge.model.session import Topic
from rsb_console.command.target import attached, chosen_route

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.control.remote_engine import RemoteEngine

_WAITS = 1.0
"""s for a bridge to answer."""
_DIRECTIONS = ["transmit", "receive"]
_DEFAULTS: dict[str, Any] = {
    "bridge": None, "control": None, "link": "", "kind": None, "kinds": tuple(KEYS), "direction": None,
}  # fmt: skip
_NOT_TYPED = ("direction", *NAME_KEYS.values())
"""Keys that `add` and `edit` have arguments of their own for."""


def bridged(parsed_args: Namespace, **_: object) -> list[str]:
    """The names of what is bridged, of the kinds that the command takes."""
    arguments = _filled(parsed_args)
    kinds = (arguments.kind,) if arguments.kind else arguments.kinds

    def names(engine: RemoteEngine) -> list[str]:
        return [
            route.topic
            for route in engine.snapshot().routes
            if route.spec.kind in kinds
            and arguments.link in ("", route.link)
            and arguments.direction in (None, route.spec.direction)
        ]

    return _asked(arguments, names)


def far_names(parsed_args: Namespace, **_: object) -> list[str]:
    """The names on the other side of what is bridged by the name that was typed."""
    arguments = _filled(parsed_args)

    def names(engine: RemoteEngine) -> list[str]:
        return [route.remote_topic for route in engine.snapshot().routes if route.topic == arguments.topic]

    return _asked(arguments, names)


def available(parsed_args: Namespace, **_: object) -> list[str]:
    """The names of what can be bridged, on either side."""
    arguments = _filled(parsed_args)
    kind = arguments.kind or "topic"

    def names(engine: RemoteEngine) -> list[str]:
        links = [arguments.link] if arguments.link else [link.name for link in engine.snapshot().links]
        asked = [engine.topics(side) for side in (None, *links)]
        answers = [future.result(_WAITS) for future in asked if future.exception(_WAITS) is None]
        return [info.topic for answer in answers for info in answer if info.kind == kind]

    return _asked(arguments, names)


def links(parsed_args: Namespace, **_: object) -> list[str]:
    """The clients of a bridge, by name."""
    return _asked(_filled(parsed_args), lambda engine: [link.name for link in engine.snapshot().links])


def awaited(**_: object) -> list[str]:
    """What one can wait for. argcomplete asks for the first word behind an option only."""
    return ["flowing", "linked", "stopped"]


def parameters(parsed_args: Namespace, **_: object) -> list[str]:
    """The parameters of the node that is named."""
    from rsb_console.command.parameters import names_of  # noqa: PLC0415 (only here)

    arguments = _filled(parsed_args)
    return _asked(arguments, lambda engine: names_of(engine, chosen_route(engine, arguments)))


def parameter_types(**_: object) -> list[str]:
    """The types that a parameter may have."""
    from rsb_console.session.parameters import KIND_NAMES  # noqa: PLC0415 (only here)

    return list(KIND_NAMES)


def lanes(**_: object) -> list[str]:
    """The services that actions and parameters consist of."""
    return sorted({lane.name for kind in LANES for lane in LANES[kind] if lane.name and not lane.is_topic})


def direction_or_keys(prefix: str, parsed_args: Namespace, **_: object) -> list[str]:
    """Of a topic its direction, or keys; of anything else keys alone."""
    arguments = _filled(parsed_args)
    directions = _DIRECTIONS if arguments.kind in (None, "topic") else []
    return [*directions, *keys(prefix, arguments)]


def keys(prefix: str, parsed_args: Namespace, **_: object) -> list[str]:
    """The keys of a topic or a service; behind a key and ``=``, its values, where they can be listed."""
    known = KEYS[_filled(parsed_args).kind or "topic"]
    key, is_pair, _value = prefix.partition("=")
    if not is_pair:
        return [f"{each}=" for each in known if each not in _NOT_TYPED]
    return [f"{key}={value}" for value in _VALUES.get(known.get(key, ""), ())]


def _choices(annotation: Any) -> list[str]:
    """The values of a literal type, or of a switch; empty: they cannot be listed."""
    if annotation is bool:
        return ["true", "false"]
    if get_origin(annotation) is Literal:
        return [str(each) for each in get_args(annotation)]
    return [choice for part in get_args(annotation) for choice in _choices(part)]


_VALUES = {field.name: _choices(field.type) for field in fields(Topic)}
_VALUES |= {"qos": [AUTO, *PROFILES], "direction": ["client", "server"], "type": [AUTO]}


def _filled(parsed_args: Namespace) -> Namespace:
    """The arguments so far, with the defaults of those that have not come yet."""
    return Namespace(**{**_DEFAULTS, **vars(parsed_args)})


def _asked(arguments: Namespace, ask: Callable[[RemoteEngine], list[str]]) -> list[str]:
    """What a running bridge answers; empty: there is none, or it does not answer in time."""
    found: list[str] = []

    def work() -> None:
        with attached(arguments, read_only=True) as engine:
            found.extend(dict.fromkeys(ask(engine)))

    threading.excepthook = lambda _: None
    asking = threading.Thread(target=work, daemon=True)
    asking.start()
    asking.join(_WAITS)
    return found
