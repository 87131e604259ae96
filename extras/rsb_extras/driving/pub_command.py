"""The command ``pub``: publishes messages by hand through a running bridge."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, NamedTuple

from msgspec.structs import asdict

from rsb_bridge.feature_api import Clock, EngineError, Wording, escape_text
from rsb_bridge.model.by_hand import END_NONE, END_ZERO, OLD_AFTER
from rsb_console.command.target import fields_from
from rsb_console.feature_console import (
    FAILURE,
    OK,
    UsageError,
    attached,
    done,
    json_line,
    print_error,
    print_line,
    print_lines,
    result,
)
from rsb_extras.driving.landing import REPORTED_WITHIN, TRIES, ByHandText, Landing, hearing
from rsb_extras.driving.publish_requests import LONGEST_REST, REST_AFTER, DraftMessage, Publish

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterable

    from rsb_bridge.feature_api import RemoteEngine, RouteSnapshot, Snapshot
    from rsb_bridge.model.audience import Audience
    from rsb_extras.driving.landing import Landed
    from rsb_extras.driving.publish_requests import Published


class _End(NamedTuple):
    """The end of a motion.

    Attributes:
        rest: the message that stops the robot, or an empty string for none.
        after: s after the last message, when the engine publishes it.
    """

    rest: str = ""
    after: float = REST_AFTER


_NO_END = _End()


_LOOK_EVERY = 0.1
"""s between two looks for a report."""


class PubText(Wording):
    """Texts of the command."""

    PUBLISHED = "published {count} on {topic} ({type_name}): {subscriptions} here{links}"
    NOT_OVER = "not over the link {link}: {reason}"
    NOBODY = "nobody gets {topic}: it has no subscription here, and no link takes it"
    HERE = "here: {hearing}"


def pub(arguments: Namespace) -> int:
    if arguments.template:
        return _template(arguments)
    if arguments.message is None:
        raise UsageError(f"pub {arguments.topic}: the message is missing; --template prints one to begin with")
    fields = fields_from(arguments.message)
    with attached(arguments, expires=True) as engine:
        return _publish(engine, arguments, fields)


def _template(arguments: Namespace) -> int:
    with attached(arguments, read_only=True) as engine:
        draft = result(engine.do(DraftMessage(arguments.topic, arguments.type)))
    if arguments.json:
        return done(arguments, type=draft.type_name, message=draft.fields, is_last=draft.is_last)
    print_lines(draft.fields.removesuffix("\n"))
    return OK


def _publish(engine: RemoteEngine, arguments: Namespace, fields: str) -> int:
    """Publish once, or at a rate until the count or an interrupt."""
    limit = arguments.count or (1 if arguments.rate is None else None)
    pause = 1.0 if arguments.rate is None else 1 / arguments.rate
    count, due, ticket = 0, engine.given_at or Clock.steady(), 0
    last: Published | None = None
    told = False
    landing = Landing(arguments.topic, engine.snapshot())
    while limit is None or count < limit:
        end = _end(engine.snapshot(), arguments.topic, pause) if arguments.rate else _NO_END
        # A message is as old as its turn, however long ago the command began.
        engine.given_at = due
        last = publish(engine, arguments.topic, fields, arguments.type, ticket, due, end)
        count, ticket = count + 1, last.ticket
        if count == 1 and limit != 1 and not arguments.json:
            _print(engine, arguments, last, count)
        if limit is None and not told and not arguments.json and landing.is_settled(engine.snapshot(), last.links):
            told = True
            _print_landed(landing.reports(engine.snapshot(), last.links))
        # Messages that a stall has delayed are not made up for: a robot would get many at once.
        due = max(due + pause, Clock.steady())
        if count != limit:
            time.sleep(max(0.0, due - Clock.steady()))
    assert last is not None
    landed = _landed(engine, landing, last.links)
    heard = last.audience.count > 0 or any(each.is_heard for each in landed)
    if arguments.json:
        missing = [
            {"link": route.link, "state": route.state, "reason": route.reason}
            for route in _not_over(engine, last, arguments.topic)
        ]
        print_line(
            json_line(
                {
                    "ok": heard,
                    "topic": arguments.topic,
                    "type": last.type_name,
                    "count": count,
                    "subscriptions": last.audience.count,
                    **_hearing(last.audience),
                    "links": last.links,
                    "not_over": missing,
                    "landed": [
                        {"link": each.link, "ok": each.is_heard, "report": each.text, **_hearing(each.audience)}
                        for each in landed
                    ],
                }
            )
        )
    elif limit == 1:
        _print(engine, arguments, last, count)
    if not arguments.json:
        _print_landed(landed)
    return OK if heard else FAILURE


def _hearing(audience: Audience) -> dict[str, object]:
    return {"heard_by": audience.nodes if audience.count else (), "deaf": [asdict(each) for each in audience.deaf]}


def _print_landed(landed: Iterable[Landed]) -> None:
    for each in landed:
        (print_line if each.is_heard else print_error)(escape_text(each.text))


def _end(snapshot: Snapshot, topic: str, pause: float) -> _End:
    """Return what ends a motion by messages at an interval (s), if the topic is armed and they are not too rare."""
    routes = [each for each in snapshot.routes if each.topic == topic and each.arming is not None]
    on_end = next((each.arming.on_end for each in routes if each.arming is not None and each.arming.armed), END_NONE)
    if on_end in ("", END_NONE) or 2 * pause > LONGEST_REST or not all(each.max_age for each in routes):
        return _NO_END
    return _End("{}" if on_end == END_ZERO else on_end, max(REST_AFTER, 2 * pause))


def publish(
    engine: RemoteEngine, topic: str, fields: str, type_name: str, ticket: int, due: float, end: _End = _NO_END
) -> Published:
    """Publish a message, with a new ticket if the one before has become too old, but the message has not.

    Args:
        topic: its name on the bridge's side.
        fields: as YAML.
        type_name: its type, or an empty string if the topic has one.
        ticket: from the answer before, or 0.
        due: time (s) of `Clock.steady` when the operator wanted it published.

    Raises:
        EngineError: the bridge refuses it, or it is too old.
        TimeoutError: the bridge does not answer.
    """
    for _ in range(TRIES):
        message = engine.do(Publish(topic, fields, type_name, ticket, end.rest, end.after))
        published = result(message)
        if published.is_done:
            return published
        # A process that stood still would get a new ticket for an old command, and a ticket would prove nothing.
        if Clock.steady() - due > OLD_AFTER:
            break
        ticket = published.ticket
    raise EngineError(ByHandText.TOO_SLOW(topic=topic))


def _landed(engine: RemoteEngine, landing: Landing, links: tuple[str, ...]) -> list[Landed]:
    """Wait for the other sides' reports on the messages."""
    deadline = Clock.steady() + REPORTED_WITHIN
    while not landing.is_settled(engine.snapshot(), links) and Clock.steady() < deadline:
        time.sleep(_LOOK_EVERY)
    return landing.reports(engine.snapshot(), links)


def _not_over(engine: RemoteEngine, published: Published, topic: str) -> list[RouteSnapshot]:
    """Return the routes that do not take the message to the other side."""
    routes = engine.snapshot().routes
    return [each for each in routes if each.outgoing and each.topic == topic and each.link not in published.links]


def _print(engine: RemoteEngine, arguments: Namespace, published: Published, count: int) -> None:
    topic = escape_text(arguments.topic)
    subscriptions = published.audience.count
    if subscriptions or published.links:
        links = f", and over the link to {escape_text(', '.join(published.links))}" if published.links else ""
        many = f"{subscriptions} subscription{'' if subscriptions == 1 else 's'}"
        what = "1 message" if count == 1 else f"{count:,} messages"
        print_line(
            PubText.PUBLISHED(
                count=what, topic=topic, type_name=escape_text(published.type_name), subscriptions=many, links=links
            )
        )
    elif not published.audience.deaf:
        print_error(PubText.NOBODY(topic=topic))
    if published.audience.deaf:
        print_error(PubText.HERE(hearing=escape_text(hearing(published.audience))))
    for route in _not_over(engine, published, arguments.topic):
        reason = escape_text(route.reason or route.state.value)
        print_error(PubText.NOT_OVER(link=escape_text(route.link), reason=reason))
