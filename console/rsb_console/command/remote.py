"""The commands that attach to a running bridge, for scripts: each is a few lines over its engine."""

from __future__ import annotations

import contextlib
import math
import os
import sys
import time
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.config.session_changes import changes, described
from rsb_bridge.model.by_hand import ASKED_FOR
from rsb_bridge.model.commands import Save
from rsb_bridge.model.link_budget import as_report, cost_of, describe_cost
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import escape_text
from rsb_bridge.model.wording import Wording
from rsb_console.command.echo import echo
from rsb_console.command.formatting import (
    json_event,
    json_line,
    links_of,
    made_by,
    pattern_text,
    patterns_of,
    rate_text,
    route_of,
    text_event,
)
from rsb_console.command.shell import FAILURE, OK, print_error, print_line
from rsb_console.command.target import (
    ANSWERED_WITHIN,
    RouteChoice,
    UsageError,
    all_chosen,
    attached,
    carried_out,
    check_link,
    chosen,
    chosen_route,
    done,
    done_with,
    failed,
    named,
    other_side,
    result,
)
from rsb_console.session.draft import TypedError, suggestion, typed_topic, values_of
from rsb_console.terminal.pulse import ASKED_EVERY, TypedKeys

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Sequence
    from concurrent.futures import Future

    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.session import Kind, Topic
    from rsb_bridge.model.snapshot import PatternSnapshot, RouteSnapshot, Snapshot, TopicInfo

_LOOK_EVERY = 0.1  # s. A round figure: a command takes so much longer at most
_SHOWN_WITHIN = 1.0
"""s from the end of an arming until the bridge's state, which comes four times a second, surely shows it."""
_ALIVE_EVERY = 1.0  # s; a console counts as gone after 5 s without a sign of life (docs/operators.md)
_EVENTS_WITHIN = 10.0
"""s for the events that a bridge remembers; with --follow, only how long one wait for more lasts. A round figure."""
_DIRECTIONS = ("transmit", "receive")
"""As the client sees it."""


class RemoteProblem(Wording):
    """Reasons why a command for a running bridge is refused, or fails."""

    STILL_DEMANDED = "; it still has to be armed, under armed ({lines}): rsb-console reload --drop-arm ends that"
    NOT_REACHED = "not {condition} within {seconds:g} s{reason}"
    CONDITION_UNKNOWN = "--for {condition}: not one of flowing TOPIC, linked [CLIENT], stopped"
    NOT_BROUGHT = "no client has brought {topic} so far{hint}"
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
    HELD_BY_ANOTHER = "{topic} has gone over to {who}"
    ASKED_FOR = "{who} asks for {topic}: Enter keeps it; without an answer it goes over in {seconds:g} s"
    NO_MORE_MESSAGES = "no more messages of {topic} within {seconds:g} s{reason}"


# --- looking


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


def print_events(arguments: Namespace) -> int:
    format_event = json_event if arguments.json else text_event
    with attached(arguments, read_only=True) as engine:
        events, seen = engine.remembered_events(_EVENTS_WITHIN), 0
        while True:
            for event in events:
                print_line(format_event(event))
                seen = event.number
            sys.stdout.flush()
            if not arguments.follow:
                return OK
            events = engine.wait_for_events(seen, _EVENTS_WITHIN)


def print_messages(arguments: Namespace) -> int:
    with attached(arguments, read_only=True) as engine:
        route = chosen_route(engine, arguments)
        if echo(engine, route, arguments):
            return OK
        why = f": {route.reason}" if (route := chosen_route(engine, arguments)).reason else ""
    return failed(
        arguments, RemoteProblem.NO_MORE_MESSAGES(topic=arguments.topic, seconds=arguments.timeout, reason=why), FAILURE
    )


# --- changing


def remove_topic(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        found = chosen(engine, arguments)
        stays = result(engine.remove_topic(found.key, drop_arm=arguments.drop_arm))
        note = RemoteProblem.STILL_DEMANDED(lines=stays) if stays else ""
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


def retry_links(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        check_link(engine, arguments.link)
        result(engine.retry(arguments.link))
        return done(arguments, f"trying again: {arguments.link or 'all links'}")


def restart_links(arguments: Namespace) -> int:
    def step(text: str) -> None:
        if not arguments.json:
            print_line(text)

    with attached(arguments) as engine:
        result(engine.restart(step))
        return done(arguments)


def reload_session(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        reloaded = result(engine.reload(dry_run=arguments.dry_run, drop_arm=arguments.drop_arm))
    if arguments.json:
        is_done = not (reloaded.left or reloaded.failed)
        about = {name: getattr(reloaded, name) for name in ("changed", "left", "failed")}
        print_line(json_line({"ok": is_done, "dry_run": arguments.dry_run, **about}))
    else:
        for line in reloaded.changed or ["no difference that can be applied in place"]:
            print_line(line)
        for line in (*reloaded.left, *reloaded.failed):
            print_error(line)
    return FAILURE if reloaded.left or reloaded.failed else OK


def save_session(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        result(engine.do(Save()))
        return done(arguments, f"saved: {engine.bridge.file}")


def stop_bridge(arguments: Namespace) -> int:
    with attached(arguments) as engine:
        result(engine.stop_bridge())
        # The answer comes before the process has ended, and a script may start the session again right after this.
        deadline = time.monotonic() + ANSWERED_WITHIN
        while not engine.unreachable:
            if time.monotonic() > deadline:
                raise TimeoutError
            time.sleep(_LOOK_EVERY)
        return done(arguments, f"stopped: {engine.name}", name=engine.name)


# --- waiting


def wait_until(arguments: Namespace) -> int:
    """Wait, and print the result. Return the exit code."""
    holds = _condition(arguments.wanted)
    began = time.monotonic()
    deadline = float("inf") if arguments.timeout is None else began + arguments.timeout
    with attached(arguments, read_only=True) as engine:
        _refuse_what_cannot_be(engine, arguments.wanted)
        while not (held := holds(engine)):
            if time.monotonic() >= deadline:
                break
            time.sleep(_LOOK_EVERY)
        reason = "" if held else _why_not(engine, arguments.wanted)
    if held:
        return done(arguments, seconds=round(time.monotonic() - began, 3))
    return failed(
        arguments,
        RemoteProblem.NOT_REACHED(condition=" ".join(arguments.wanted), seconds=arguments.timeout, reason=reason),
        FAILURE,
    )


def _condition(wanted: list[str]) -> Callable[[RemoteEngine], bool]:
    match wanted:
        case ["flowing", topic]:
            return lambda engine: _flows(engine, topic)
        case ["linked"]:
            return lambda engine: any(link.state is State.OK for link in engine.snapshot().links)
        case ["linked", name]:
            return lambda engine: (name, State.OK) in [(link.name, link.state) for link in engine.snapshot().links]
        case ["stopped"]:
            return lambda engine: not engine.snapshot().running
    raise UsageError(RemoteProblem.CONDITION_UNKNOWN(condition=" ".join(wanted)))


def _refuse_what_cannot_be(engine: RemoteEngine, wanted: list[str]) -> None:
    """Refuse a name that this bridge does not know and that no client can add.

    A client knows its topics from the start, and a server its clients; but a server learns a client's topics when they
    link, so there a topic may yet come.

    Raises:
        UsageError: the wait could never end.
    """
    now = engine.snapshot()
    match wanted:
        case ["flowing", topic] if now.role == "client":
            known = [route.topic for route in now.routes]
            if not named(now.routes, topic):
                raise UsageError(f"{topic} is not bridged{suggestion(topic, known)}; `rsb-console add` adds a topic")
        case ["linked", name]:
            check_link(engine, name)


def _flows(engine: RemoteEngine, topic: str) -> bool:
    """Whether every route of a name carries messages, at any rate and with or without subscribers, or can be called."""
    routes = named(engine.snapshot().routes, topic)
    return bool(routes) and all(map(_carries, routes))


def _carries(route: RouteSnapshot) -> bool:
    if route.spec.kind == "topic":
        # An earlier process may have delivered the messages that the far side keeps of a latched topic.
        return route.state.flows and (route.ledger.delivered > 0 or _has_passed(route, "published"))
    return _has_passed(route, "offered")


def _has_passed(route: RouteSnapshot, name: str) -> bool:
    return any(stage.name == name and stage.done for stage in route.stages)


def _why_not(engine: RemoteEngine, wanted: list[str]) -> str:
    now = engine.snapshot()
    reasons = [engine.unreachable]
    if wanted[0] == "flowing":
        routes = named(now.routes, wanted[1])
        reasons += [rate_text(route) for route in routes] or [_not_bridged(now, wanted[1])]
    if wanted[0] == "linked":
        meant = [link for link in now.links if link.name in wanted[1:] or not wanted[1:]]
        reasons += [f"{link.name}: {link.reason}" for link in meant if link.state is not State.OK]
    found = [reason for reason in reasons if reason]
    return f": {'; '.join(found)}" if found else ""


def _not_bridged(now: Snapshot, topic: str) -> str:
    hint = suggestion(topic, [route.topic for route in now.routes])
    problem = RemoteProblem.NOT_BROUGHT if now.role == "server" else RouteChoice.NOT_BRIDGED
    return problem(topic=topic, hint=hint)


# --- adding and editing


def add_topic(arguments: Namespace) -> int:
    """Bridge one more topic or service. Return the exit code."""
    kind: Kind = arguments.kind or "topic"
    values = {"topic": arguments.topic, "kind": kind}
    if kind == "topic":
        values["direction"], keys = _direction_and_keys(arguments)
    else:
        keys = _provider_and_keys(arguments, kind)
    if (arguments.rate or arguments.size) and not arguments.dry_run:
        raise UsageError(RemoteProblem.RATE_WITHOUT_DRY_RUN(topic=arguments.topic))
    with attached(arguments) as engine:
        check_link(engine, arguments.link)
        links = [link.name for link in engine.snapshot().links]
        if not links:
            raise UsageError(RemoteProblem.NO_CLIENT(topic=arguments.topic))
        if len(links) > 1 and not arguments.link:
            raise UsageError(RemoteProblem.CLIENT_MISSING(topic=arguments.topic, links=" or --link ".join(links)))
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
            raise UsageError(RemoteProblem.NOTHING_TO_CHANGE(topic=arguments.topic))
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
        raise UsageError(RemoteProblem.PROVIDER_OF_A_TOPIC(topic=arguments.topic))
    if given is None:
        raise UsageError(RemoteProblem.DIRECTION_MISSING(topic=arguments.topic))
    hint = suggestion(given, _DIRECTIONS) or "."
    raise UsageError(RemoteProblem.DIRECTION_UNKNOWN(topic=arguments.topic, word=given, hint=hint))


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
        raise UsageError(RemoteProblem.PROVIDER_MISSING(topic=arguments.topic, kind=kind))
    raise UsageError(RemoteProblem.KEY_WITHOUT_VALUE(topic=arguments.topic, word=given, kind=kind))


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


# --- arming


def _standard_input() -> int:
    """Return the descriptor of standard input, or one that is at its end if it is closed."""
    try:
        return sys.stdin.fileno()
    except (AttributeError, OSError):  # a closed one, as of some services
        return os.open(os.devnull, os.O_RDONLY)


def arm_topic(arguments: Namespace) -> int:
    """Arm a topic until this process ends in any way; then the bridge disarms it. Return the exit code."""
    # The console detaches first, which disarms: the terminal's last answer may take its time.
    with TypedKeys(_standard_input(), os.environ) as keys, attached(arguments, expires=True) as engine:
        route = chosen_route(engine, arguments)
        arm = engine.take_arming if arguments.take else engine.ask_holder if arguments.ask else engine.arm
        _wait_alive(engine, arm(route.key, shared=True))  # shared with `rsb-console pub` in another shell
        engine.given_at = None  # what follows is given by young keys, however long ago this one attached
        _say_armed(arguments, route)
        why, cause = _hold(engine, route, keys)
    return failed(arguments, why, FAILURE, cause=cause)


def _wait_alive(engine: RemoteEngine, arming: Future[None]) -> None:
    """Wait for the end of an arming, and give signs of life: the question of a silent console ends.

    Raises:
        EngineError: it is not armed.
        TimeoutError: the bridge does not answer.
    """
    deadline = time.monotonic() + ANSWERED_WITHIN
    while time.monotonic() < deadline:
        with contextlib.suppress(TimeoutError):
            return arming.result(_ALIVE_EVERY)
        engine.keep_armed(pressed=False)
    raise TimeoutError


def _say_armed(arguments: Namespace, route: RouteSnapshot) -> None:
    if arguments.json:
        print_line(json_line({"ok": True, "armed": True, "topic": route.topic, "link": route.link}))
    else:
        deadman = route.arming.deadman if route.arming is not None else 0.0
        keys = f"press Enter within {deadman:g} s, again and again; " if deadman else ""
        print_line(f"{route.topic} of {route.link} is ARMED: {keys}Ctrl-C disarms it")
    sys.stdout.flush()


def _hold(engine: RemoteEngine, route: RouteSnapshot, keys: TypedKeys) -> tuple[str, str]:
    """Keep a topic armed; once this process holds it no longer, return that with the reason, and the cause."""
    topic, asked_by, lost_at = route.topic, "", math.inf
    while True:
        pressed = keys.wait(ASKED_EVERY)
        holds = route.key in result(engine.keep_armed(pressed=pressed)).keys
        # From the first answer that has it: a bridge that hung shows its old state for a moment.
        lost_at = math.inf if holds else min(lost_at, time.monotonic())
        if pressed and asked_by:  # pressing Enter means driving
            with contextlib.suppress(EngineError):  # it is over
                result(engine.answer_asker(route.key, gives=False, who=asked_by))
        now = next((each for each in engine.snapshot().routes if each.key == route.key), None)
        if now is None or now.arming is None or not now.arming.armed or engine.unreachable:
            reason, cause = _why_disarmed(engine, now)
            return f"{topic} is no longer armed: {reason}", cause
        if time.monotonic() - lost_at > _SHOWN_WITHIN:
            return RemoteProblem.HELD_BY_ANOTHER(topic=topic, who=escape_text(now.arming.by)), "held_by_another"
        if holds and now.arming.asked_by != asked_by:
            asked_by = now.arming.asked_by
            if asked_by:
                print_error(RemoteProblem.ASKED_FOR(who=escape_text(asked_by), topic=topic, seconds=ASKED_FOR))


def _why_disarmed(engine: RemoteEngine, route: RouteSnapshot | None) -> tuple[str, str]:
    """Return why a topic is no longer armed, in words and as a cause."""
    if engine.unreachable:
        return engine.unreachable, ""
    if route is None:
        return "it is not bridged any more", "removed"
    if route.arming is None:
        return "arming is not required any more", ""
    # The route's reason advises to arm it again, although a colleague may just have disarmed it.
    return route.arming.reason or route.reason, route.arming.why


def disarm_topic(arguments: Namespace) -> int:
    """Disarm all routes of a name. Return the exit code."""
    with attached(arguments) as engine:
        routes = all_chosen(engine, arguments)
        carried_out([engine.disarm(route.key) for route in routes])
        return done_with(arguments, routes, "disarmed")
