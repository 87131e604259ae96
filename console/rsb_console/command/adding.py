"""`add` and `edit`: a topic, a service, an action or a node's parameters from what the command line says."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.link_budget import as_report, cost_of, told
from rsb_console.command.shell import OK, print_line
from rsb_console.command.target import (
    UsageError,
    attached,
    check_link,
    chosen,
    done,
    result,
)
from rsb_console.session.draft import values_of
from rsb_console.session.typed_topic import TypedError, suggestion, typed_topic

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.session import Kind, Topic

_DIRECTIONS = ("transmit", "receive")
"""As the client sees it."""


def add(arguments: Namespace) -> int:
    """Bridge one more. Returns the exit code."""
    kind: Kind = arguments.kind or "topic"
    values = {"topic": arguments.topic, "kind": kind}
    if kind == "topic":
        values["direction"], keys = _direction_and_keys(arguments)
    else:
        keys = _provider_and_keys(arguments, kind)
    if (arguments.rate or arguments.size) and not arguments.dry_run:
        raise UsageError(f"add {arguments.topic}: --rate and --size are for --dry-run, which adds nothing")
    with attached(arguments) as engine:
        check_link(engine, arguments.link)
        links = [link.name for link in engine.snapshot().links]
        if len(links) > 1 and not arguments.link:
            raise UsageError(f"add {arguments.topic}: with which client? --link {' or --link '.join(links)}")
        topic = _topic(values, keys, engine, None)
        if arguments.dry_run:
            return _say_cost(arguments, topic, engine, arguments.link or links[0])
        return done(arguments, key=result(engine.add_topic(topic, arguments.link)))


def _say_cost(arguments: Namespace, topic: Topic, engine: RemoteEngine, link: str) -> int:
    """Say what a topic would cost. Returns the exit code."""
    if topic.kind != "topic":
        raise UsageError(f"add {topic.topic}: --dry-run is about topics: calls go ahead of them, and are not budgeted")
    now = engine.snapshot()
    sends_here = (topic.direction == "transmit") == (now.role == "client")
    names = {topic.topic, topic.remote_topic, f"/{link}{topic.topic}"}
    found = result(engine.topics(None if sends_here else link))
    type_name = next((info.type_name for info in found if info.topic in names), "")
    cost = cost_of(now, link, topic, type_name=type_name, rate=arguments.rate, size=arguments.size)
    if arguments.json:
        return done(arguments, cost=as_report(cost))
    for line in told(cost, now.time):
        print_line(line)
    return OK


def edit(arguments: Namespace) -> int:
    """Change one that is bridged. Returns the exit code."""
    with attached(arguments) as engine:
        route = chosen(engine, arguments)
        if not arguments.keys:
            raise UsageError(f"edit {arguments.topic}: nothing to change; for example: max_rate=5")
        topic = _topic(values_of(route.spec), arguments.keys, engine, route.spec)
        return done(arguments, key=result(engine.edit_topic(route.key, topic, drop_arm=arguments.drop_arm)))


def _direction_and_keys(arguments: Namespace) -> tuple[str, list[str]]:
    """The direction of a topic to be added, and its keys and values, which may come in any order.

    Raises:
        UsageError: the direction is missing, or is none.
    """
    words = _words(arguments)
    given = next((word for word in words if "=" not in word), None)
    if given in _DIRECTIONS and arguments.provider is None:
        words.remove(given)
        return given, words
    if arguments.provider is not None:
        what = "a topic has a direction, and no provider; --service adds a service."
    elif given is None:
        what = "the direction is missing."
    else:
        what = f"{given!r} is no direction{suggestion(given, _DIRECTIONS) or '.'}"
    raise UsageError(
        f"add {arguments.topic}: {what} transmit takes it from the client to the server, receive from the server to "
        f"the client, for example: rsb-console add {arguments.topic} transmit"
    )


def _provider_and_keys(arguments: Namespace, kind: Kind) -> list[str]:
    """The keys and values of what is no topic, with its provider.

    Raises:
        UsageError: there is a direction instead, or no provider.
    """
    words = _words(arguments)
    if arguments.provider is not None:
        words = [f"provider={arguments.provider}", *words]
    given = next((word for word in words if "=" not in word), None)
    if given is None and any(word.startswith("provider=") for word in words):
        return words
    what = "the provider is missing" if given is None else f"{given!r} is no KEY=VALUE"
    raise UsageError(
        f"add {arguments.topic}: {what}. It is the side whose node answers, client or server, for example: rsb-console "
        f"add {arguments.topic} --kind {kind} --provider client"
    )


def _words(arguments: Namespace) -> list[str]:
    return [*([] if arguments.direction is None else [arguments.direction]), *arguments.keys]


def _topic(values: dict[str, str], keys: list[str], engine: RemoteEngine, replaced: Topic | None) -> Topic:
    """A topic of the values that it has already and those of the command line.

    Raises:
        UsageError: something is wrong with it.
    """
    try:
        return typed_topic(values, keys, engine.session, replaced)
    except TypedError as error:
        raise UsageError(str(error)) from None
