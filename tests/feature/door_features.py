"""The package of features with which `test_door` tries the door; here, nothing imports it."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any, ClassVar

from rsb_bridge.feature import EntryKey, Feature, SessionKey

if TYPE_CHECKING:
    from collections.abc import Iterable

METHODS = {name for name, _ in inspect.getmembers(Feature, inspect.isfunction) if not name.startswith("_")}


def _raising(name: str) -> Any:
    def method(*_: Any) -> Any:
        raise RuntimeError(f"{name} fails")

    return method


FAILING = type("Failing", (Feature,), {"name": "failing", **{name: _raising(name) for name in METHODS}})()

TAKEN = (
    ("subcommands", "status"),
    ("session_keys", "server_ip"),
    ("session_keys", "services"),
    ("topic_keys", "max_rate"),
    ("topic_keys", "provider"),
    ("commands", "add"),
    ("messages", "ping"),
    ("columns", "AGE"),
    ("link_facts", "peer"),
    ("route_facts", "Rate"),
    ("console_settings", "theme"),
    ("transport_traits", "tcp"),
    ("actions", "help"),
    ("actions", "question_mark"),
    ("purposes", "topic"),
    ("checks", "clock"),
)
"""Names of the core, or of another feature, that the greedy feature takes, by the method that adds them."""


class Greedy(Feature):
    """Takes a name of each kind."""

    name = "greedy"

    def messages(self) -> Iterable[Any]:
        from rsb_bridge.wire.messages import ControlMessageBase

        class Ping(ControlMessageBase, frozen=True, tag="ping"):
            pass

        return (Ping,)

    def purposes(self) -> Iterable[Any]:
        from rsb_bridge.model.purposes import Purpose

        return (Purpose("topic"),)

    def transport_traits(self) -> Iterable[Any]:
        from rsb_bridge.model.transport_traits import TransportTraits

        return (type("Tcp", (TransportTraits,), {"name": "tcp"}),)

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        return SessionKey("server_ip", str, ""), SessionKey("services", str, "")

    def topic_keys(self) -> Iterable[EntryKey[Any]]:
        taken = [EntryKey(name, str, "", "Taken", "Taken.") for name in ("max_rate", "provider")]
        odd = EntryKey("odd", list, None, "Odd", "A list.")  # type: ignore[arg-type]
        return (*taken, odd, EntryKey("fine_key", bool, default=False, label="Fine", help="Its own."))

    def commands(self) -> Iterable[Any]:
        from rsb_bridge.model.commands import Command

        class Add(Command[None], frozen=True, tag="add"):
            pass

        return (Add,)

    def subcommands(self, add: Any, complete: Any) -> None:
        add("status", print, "takes a command of the core").add_argument("--more")
        add("fine", print, "is its own")

    def actions(self) -> Iterable[Any]:
        from rsb_console.actions.action import Action, Group

        return (
            Action("help", "f8", "Help", "Take an action of the core", Group.VIEW),
            Action("greedy", "question_mark,f9", "Greedy", "Take a key of the core", Group.VIEW, run=print),
        )

    def console_settings(self) -> Iterable[Any]:
        from rsb_console.notation.console_setting import ConsoleSetting

        return (ConsoleSetting("theme", "", str),)

    def columns(self) -> Iterable[Any]:
        from rsb_console.notation.topic_column import TopicColumn

        return (TopicColumn("AGE", "nothing", 5, str),)

    def link_facts(self) -> Iterable[Any]:
        from rsb_console.notation.link_fact import LinkFact

        return (LinkFact("peer", lambda _: ("nothing",)),)

    def route_facts(self) -> Iterable[Any]:
        from rsb_console.notation.route_fact import RouteFact

        return (RouteFact("Rate", lambda _: "nothing"),)

    def checks(self) -> Iterable[Any]:
        from rsb_bridge.model.finding import Check

        return (Check("clock", "clock", tuple),)


class Needy(Feature):
    name = "needy"
    needs: ClassVar[tuple[str, ...]] = ("no_such_feature",)


class Older(Feature):
    name = "older"
    API: ClassVar[int] = 0


OLDER = Older()
GREEDY, TWIN, NEEDY = Greedy(), Greedy(), Needy()
