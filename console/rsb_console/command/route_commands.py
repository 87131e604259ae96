"""The commands for topics and services of a running bridge."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.session_changes import changes, described
from rsb_bridge.model.link_budget import as_report, cost_of, describe_cost
from rsb_bridge.model.snapshot import RouteSnapshot, State
from rsb_bridge.model.wording import Wording
from rsb_console.command.formatting import links_of, made_by, pattern_text, patterns_of, rate_text, route_of
from rsb_console.command.target import (
    UsageError,
    agreed,
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
    from rsb_bridge.model.snapshot import PatternSnapshot, TopicInfo

_DIRECTIONS = ("transmit", "receive")  # as the client sees it
_NOT_SAVED = "; not saved (rsb-console save)"
_ABOUT_DIRECTION = (
    "transmit takes it from the client to the server, receive from the server to the client, "
    "for example: rsb-console add {topic} transmit"
)
_ABOUT_PROVIDER = (
    "the side whose node answers, client or server, for example: "
    "rsb-console add {topic} --kind {kind} --provider client"
)


class TopicCommandProblem(Wording):
    """Reasons why a topic is not added or changed."""

    DROP = "{topic} has to be armed, and its name stays under armed. Drop this demand, too?"
    STILL_DEMANDED = "; it still has to be armed, under armed ({lines}): rsb-console reload --drop-arm ends that"
    NO_CLIENT = "add {topic}: the server has no client yet; `rsb-console client add NAME` adds one"
    CLIENT_MISSING = "add {topic}: several clients; choose one with --link {links}"
    RATE_WITHOUT_DRY_RUN = "add {topic}: --rate and --size are for --dry-run, which adds nothing"
    NOTHING_TO_CHANGE = "edit {topic}: nothing to change; for example: max_rate=5"
    PROVIDER_OF_A_TOPIC = (
        "add {topic}: a topic has a direction, and no provider; --service adds a service. " + _ABOUT_DIRECTION
    )
    DIRECTION_MISSING = "add {topic}: the direction is missing. " + _ABOUT_DIRECTION
    DIRECTION_UNKNOWN = "add {topic}: {word!r} is no direction{hint} " + _ABOUT_DIRECTION
    PROVIDER_MISSING = "add {topic}: the provider is missing. It is " + _ABOUT_PROVIDER
    KEY_WITHOUT_VALUE = "add {topic}: {word!r} is no KEY=VALUE. The provider is " + _ABOUT_PROVIDER


def print_topics(arguments: Namespace) -> int:
    with attached(arguments, read_only=True) as engine:
        if arguments.available:
            return _available(engine, arguments)
        now = engine.snapshot()
        found = [(route.link, f"{rate_text(route)}{made_by(route)}") for route in now.routes]
        found += [(pattern.link, pattern_text(pattern)) for pattern in patterns_of(now)]
        several = engine.bridge.role == "server"
        lines = [f"{link}: {text}" if several else text for link, text in found]
        return done(arguments, *lines, links=links_of(now), topics=[route_of(route) for route in now.routes])


def _available(engine: RemoteEngine, arguments: Namespace) -> int:
    sides: dict[str, tuple[TopicInfo, ...]] = {"here": result(engine.topics())}
    for link in engine.snapshot().links:
        if link.state is State.OK:
            sides[other_side(engine, link.name)] = result(engine.topics(link.name))
    lines, available = [], []
    for side, infos in sides.items():
        for info in infos:
            ends = ("publishers", "subscriptions") if info.kind == "topic" else ("providers", "callers")
            type_name = f" {info.type_name}" if info.type_name else ""  # a node with parameters has none
            counts = f"{ends[0]}: {info.publishers}, {ends[1]}: {info.subscriptions}"
            lines.append(f"{side}: {info.kind} {info.topic}{type_name}, {counts}")
            available.append(
                {"side": side, "kind": info.kind, "topic": info.topic, "type": info.type_name,
                 "publishers": info.publishers, "subscriptions": info.subscriptions}
            )  # fmt: skip
    return done(arguments, *lines, available=available)


def remove_topic(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        found, drops = chosen(engine, arguments), arguments.drop_arm
        entry = engine.session.entry(found.link, found.spec.identity)
        arming = found.arming if isinstance(found, RouteSnapshot) else None
        can_end = entry is not None and entry.arm and not (arming is not None and arming.is_demanded_twice)
        if drops is None and can_end:
            question = TopicCommandProblem.DROP(topic=arguments.topic)
            drops = agreed(question, "--drop-arm or --keep-arm", ask=not arguments.json)
        stays = result(engine.remove_topic(found.key, drop_arm=bool(drops)))
        note = TopicCommandProblem.STILL_DEMANDED(lines=stays) if stays else ""
        return _changed(engine, arguments, [found], "removed", note=note, demanded=bool(stays))


def _changed(
    engine: RemoteEngine,
    arguments: Namespace,
    found: Sequence[RouteSnapshot | PatternSnapshot],
    effect: str,
    note: str = "",
    **results: object,
) -> int:
    """Report a change of the session as `done_with` does, and whether the session is saved."""
    unsaved = engine.snapshot().unsaved  # a bridge sends its new state before its answer
    note += _NOT_SAVED if unsaved else ""
    return done_with(arguments, found, effect, note=note, unsaved=unsaved, **results)


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
    kind: Kind = arguments.kind or "topic"
    # The words may come in any order: a direction, and keys with values.
    words = [*([] if arguments.direction is None else [arguments.direction]), *arguments.keys]
    values = {"topic": arguments.topic, "kind": kind}
    if kind == "topic":
        values["direction"], keys = _direction_and_keys(arguments, words)
    else:
        keys = _provider_and_keys(arguments, kind, words)
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
        unsaved = engine.snapshot().unsaved
        side = other_side(engine, arguments.link or links[0])
        text = f"added: {described(topic)}, with {side}{_NOT_SAVED if unsaved else ''}"
        return done(arguments, text, key=key, unsaved=unsaved)


def _say_cost(arguments: Namespace, topic: Topic, engine: RemoteEngine, link: str) -> int:
    if topic.kind != "topic":
        raise UsageError(f"add {topic.topic}: --dry-run is for topics only; calls go first and have no budget")
    now = engine.snapshot()
    sends_here = (topic.direction == "transmit") == (now.role == "client")
    # The sending side may know the topic by any of these names.
    names = {topic.topic, topic.remote_topic, f"/{link}{topic.topic}"}
    found = result(engine.topics(None if sends_here else link))
    type_name = next((info.type_name for info in found if info.topic in names), "")
    cost = cost_of(now, link, topic, type_name=type_name, rate=arguments.rate, size=arguments.size)
    return done(arguments, *describe_cost(cost, now.time), cost=as_report(cost))


def edit_topic(arguments: Namespace) -> int:
    with attached(arguments, expires=True) as engine:
        route = chosen(engine, arguments)
        if not arguments.keys:
            raise UsageError(TopicCommandProblem.NOTHING_TO_CHANGE(topic=arguments.topic))
        topic = _topic(values_of(route.spec), arguments.keys, engine, route.spec)
        key = result(engine.edit_topic(route.key, topic, drop_arm=arguments.drop_arm, seen=route.spec))
        what = f"changed ({', '.join(changes(route.spec, topic)) or 'nothing'})"
        return _changed(engine, arguments, [route], what, key=key)


def _direction_and_keys(arguments: Namespace, words: list[str]) -> tuple[str, list[str]]:
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


def _provider_and_keys(arguments: Namespace, kind: Kind, words: list[str]) -> list[str]:
    if arguments.provider is not None:
        words = [f"provider={arguments.provider}", *words]
    given = next((word for word in words if "=" not in word), None)
    if given is None and any(word.startswith("provider=") for word in words):
        return words
    if given is None:
        raise UsageError(TopicCommandProblem.PROVIDER_MISSING(topic=arguments.topic, kind=kind))
    raise UsageError(TopicCommandProblem.KEY_WITHOUT_VALUE(topic=arguments.topic, word=given, kind=kind))


def _topic(values: dict[str, str], keys: list[str], engine: RemoteEngine, replaced: Topic | None) -> Topic:
    try:
        return typed_topic(values, keys, engine.session, replaced)
    except TypedError as error:
        raise UsageError(str(error)) from None
