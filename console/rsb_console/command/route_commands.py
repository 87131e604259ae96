"""The commands for topics and services of a running bridge."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.session_changes import changes, described
from rsb_bridge.model.link_budget import as_report, cost_of, describe_cost
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.wording import Wording
from rsb_console.command.formatting import json_line, links_of, made_by, pattern_text, patterns_of, rate_text, route_of
from rsb_console.command.shell import OK, print_line
from rsb_console.command.target import (
    UsageError,
    all_chosen,
    attached,
    carried_out,
    check_link,
    chosen,
    done,
    done_with,
    other_side,
    result,
)
from rsb_console.session.draft import TypedError, suggestion, typed_topic, values_of

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.session import Kind, Topic
    from rsb_bridge.model.snapshot import PatternSnapshot, RouteSnapshot, TopicInfo

_DIRECTIONS = ("transmit", "receive")
"""As the client sees it."""


class TopicCommandProblem(Wording):
    """Reasons why a topic is not added or changed."""

    STILL_DEMANDED = "; it still has to be armed, under armed ({lines}): rsb-console reload --drop-arm ends that"
    NO_CLIENT = "add {topic}: the server has no client yet; `rsb-console client add NAME` adds one"
    CLIENT_MISSING = "add {topic}: several clients; choose one with --link {links}"
    RATE_WITHOUT_DRY_RUN = "add {topic}: --rate and --size are for --dry-run, which adds nothing"
    NOTHING_TO_CHANGE = "edit {topic}: nothing to change; for example: max_rate=5"
    PROVIDER_OF_A_TOPIC = (
        "add {topic}: a topic has a direction, and no provider; --service adds a service. transmit takes it from the "
        "client to the server, receive from the server to the client, for example: rsb-console add {topic} transmit"
    )
    DIRECTION_MISSING = (
        "add {topic}: the direction is missing. transmit takes it from the client to the server, receive from the "
        "server to the client, for example: rsb-console add {topic} transmit"
    )
    DIRECTION_UNKNOWN = (
        "add {topic}: {word!r} is no direction{hint} transmit takes it from the client to the server, receive from the "
        "server to the client, for example: rsb-console add {topic} transmit"
    )
    PROVIDER_MISSING = (
        "add {topic}: the provider is missing. It is the side whose node answers, client or server, for example: "
        "rsb-console add {topic} --kind {kind} --provider client"
    )
    KEY_WITHOUT_VALUE = (
        "add {topic}: {word!r} is no KEY=VALUE. The provider is the side whose node answers, client or server, for "
        "example: rsb-console add {topic} --kind {kind} --provider client"
    )


def print_topics(arguments: Namespace) -> int:
    with attached(arguments, read_only=True) as engine:
        if arguments.available:
            return _available(engine, arguments)
        now = engine.snapshot()
        if arguments.json:
            topics = [route_of(route) for route in now.routes]
            print_line(json_line({"ok": True, "links": links_of(now), "topics": topics}))
        for route in () if arguments.json else now.routes:
            link = f"{route.link}: " if engine.bridge.role == "server" else ""
            print_line(f"{link}{rate_text(route)}{made_by(route)}")
        for pattern in () if arguments.json else patterns_of(now):
            link = f"{pattern.link}: " if engine.bridge.role == "server" else ""
            print_line(f"{link}{pattern_text(pattern)}")
        return OK


def _available(engine: RemoteEngine, arguments: Namespace) -> int:
    sides: dict[str, tuple[TopicInfo, ...]] = {"here": result(engine.topics())}
    for link in engine.snapshot().links:
        if link.state is State.OK:
            sides[other_side(engine, link.name)] = result(engine.topics(link.name))
    found = [
        {"side": side, "kind": info.kind, "topic": info.topic, "type": info.type_name,
         "publishers": info.publishers, "subscriptions": info.subscriptions}
        for side, infos in sides.items() for info in infos
    ]  # fmt: skip
    if arguments.json:
        print_line(json_line({"ok": True, "available": found}))
    for info in () if arguments.json else found:
        ends = "publishers: {publishers}, subscriptions: {subscriptions}"
        if info["kind"] != "topic":
            ends = "providers: {publishers}, callers: {subscriptions}"
        type_name = " {type}" if info["type"] else ""  # a node with parameters has none
        print_line(f"{{side}}: {{kind}} {{topic}}{type_name}, {ends}".format(**info))
    return OK


def remove_topic(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        found = chosen(engine, arguments)
        stays = result(engine.remove_topic(found.key, drop_arm=arguments.drop_arm))
        note = TopicCommandProblem.STILL_DEMANDED(lines=stays) if stays else ""
        return _changed(engine, arguments, [found], "removed", note=note, demanded=bool(stays))


def _changed(
    engine: RemoteEngine,
    arguments: Namespace,
    found: Sequence[RouteSnapshot | PatternSnapshot],
    what: str,
    note: str = "",
    **results: object,
) -> int:
    """Report a change of the session as `done_with` does, and whether the session is saved."""
    unsaved = engine.snapshot().unsaved
    return done_with(arguments, found, what, note=f"{note}{_not_saved(engine)}", unsaved=unsaved, **results)


def _not_saved(engine: RemoteEngine) -> str:
    """Return the note on a session that differs from its file, or an empty string."""
    # The state of after a change comes before its answer.
    return "; not saved (rsb-console save)" if engine.snapshot().unsaved else ""


def pause_topic(arguments: Namespace, *, paused: bool = True) -> int:
    # Only resuming can move something: a pause is right however late it comes.
    with attached(arguments, expires=not paused) as engine:
        found = all_chosen(engine, arguments)
        carried_out([engine.pause(each.key, paused) for each in found])
        return _changed(engine, arguments, found, "paused" if paused else "resumed")


def resume_topic(arguments: Namespace) -> int:
    return pause_topic(arguments, paused=False)


def acknowledge(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        what = "not acknowledged any more" if arguments.undo else "acknowledged"
        # A link's name is no topic's, which begins with a slash.
        if arguments.topic in {link.name for link in engine.snapshot().links}:
            result(engine.acknowledge("", not arguments.undo, link=arguments.topic))
            return done(arguments, f"{what}: link {arguments.topic}")
        found = chosen(engine, arguments)
        result(engine.acknowledge(found.key, not arguments.undo))
        return done_with(arguments, [found], what)


def add_topic(arguments: Namespace) -> int:
    """Bridge one more topic or service. Return the exit code."""
    kind: Kind = arguments.kind or "topic"
    values = {"topic": arguments.topic, "kind": kind}
    if kind == "topic":
        values["direction"], keys = _direction_and_keys(arguments)
    else:
        keys = _provider_and_keys(arguments, kind)
    if (arguments.rate or arguments.size) and not arguments.dry_run:
        raise UsageError(TopicCommandProblem.RATE_WITHOUT_DRY_RUN(topic=arguments.topic))
    with attached(arguments) as engine:
        check_link(engine, arguments.link)
        links = [link.name for link in engine.snapshot().links]
        if not links:
            raise UsageError(TopicCommandProblem.NO_CLIENT(topic=arguments.topic))
        if len(links) > 1 and not arguments.link:
            raise UsageError(TopicCommandProblem.CLIENT_MISSING(topic=arguments.topic, links=" or --link ".join(links)))
        topic = _topic(values, keys, engine, None)
        if arguments.dry_run:
            return _say_cost(arguments, topic, engine, arguments.link or links[0])
        key = result(engine.add_topic(topic, arguments.link))
        side = other_side(engine, arguments.link or links[0])
        text = f"added: {described(topic)}, with {side}{_not_saved(engine)}"
        return done(arguments, text, key=key, unsaved=engine.snapshot().unsaved)


def _say_cost(arguments: Namespace, topic: Topic, engine: RemoteEngine, link: str) -> int:
    """Print the cost of a topic. Return the exit code."""
    if topic.kind != "topic":
        raise UsageError(f"add {topic.topic}: --dry-run is for topics only; calls go first and have no budget")
    now = engine.snapshot()
    sends_here = (topic.direction == "transmit") == (now.role == "client")
    # The sending side may know the topic by any of these names.
    names = {topic.topic, topic.remote_topic, f"/{link}{topic.topic}"}
    found = result(engine.topics(None if sends_here else link))
    type_name = next((info.type_name for info in found if info.topic in names), "")
    cost = cost_of(now, link, topic, type_name=type_name, rate=arguments.rate, size=arguments.size)
    if arguments.json:
        return done(arguments, cost=as_report(cost))
    for line in describe_cost(cost, now.time):
        print_line(line)
    return OK


def edit_topic(arguments: Namespace) -> int:
    """Change a bridged topic or service. Return the exit code."""
    with attached(arguments, expires=True) as engine:
        route = chosen(engine, arguments)
        if not arguments.keys:
            raise UsageError(TopicCommandProblem.NOTHING_TO_CHANGE(topic=arguments.topic))
        topic = _topic(values_of(route.spec), arguments.keys, engine, route.spec)
        key = result(engine.edit_topic(route.key, topic, drop_arm=arguments.drop_arm, seen=route.spec))
        what = f"changed ({', '.join(changes(route.spec, topic)) or 'nothing'})"
        return _changed(engine, arguments, [route], what, key=key)


def _direction_and_keys(arguments: Namespace) -> tuple[str, list[str]]:
    """Return the direction of a topic to be added, and its keys and values, given in any order.

    Raises:
        UsageError: the direction is missing, or is none.
    """
    words = _words(arguments)
    given = next((word for word in words if "=" not in word), None)
    if given in _DIRECTIONS and arguments.provider is None:
        words.remove(given)
        return given, words
    if arguments.provider is not None:
        raise UsageError(TopicCommandProblem.PROVIDER_OF_A_TOPIC(topic=arguments.topic))
    if given is None:
        raise UsageError(TopicCommandProblem.DIRECTION_MISSING(topic=arguments.topic))
    hint = suggestion(given, _DIRECTIONS) or "."
    raise UsageError(TopicCommandProblem.DIRECTION_UNKNOWN(topic=arguments.topic, word=given, hint=hint))


def _provider_and_keys(arguments: Namespace, kind: Kind) -> list[str]:
    """Return the keys and values of a service, an action or parameters, with the provider.

    Raises:
        UsageError: there is a direction instead, or no provider.
    """
    words = _words(arguments)
    if arguments.provider is not None:
        words = [f"provider={arguments.provider}", *words]
    given = next((word for word in words if "=" not in word), None)
    if given is None and any(word.startswith("provider=") for word in words):
        return words
    if given is None:
        raise UsageError(TopicCommandProblem.PROVIDER_MISSING(topic=arguments.topic, kind=kind))
    raise UsageError(TopicCommandProblem.KEY_WITHOUT_VALUE(topic=arguments.topic, word=given, kind=kind))


def _words(arguments: Namespace) -> list[str]:
    return [*([] if arguments.direction is None else [arguments.direction]), *arguments.keys]


def _topic(values: dict[str, str], keys: list[str], engine: RemoteEngine, replaced: Topic | None) -> Topic:
    """Build a topic from given values and the keys of the command line.

    Raises:
        UsageError: the topic is invalid.
    """
    try:
        return typed_topic(values, keys, engine.session, replaced)
    except TypedError as error:
        raise UsageError(str(error)) from None
