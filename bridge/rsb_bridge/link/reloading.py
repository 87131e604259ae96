"""What has to be done so that a running bridge does what its session says now, step by step.

Each step says what it changes and does it, so that what an operator is shown before is what happens after.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.config.difference import changes, described
from rsb_bridge.config.keys import fingerprint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from rsb_bridge.config.keys import Key
    from rsb_bridge.link.client import ClientLink
    from rsb_bridge.link.link import Link
    from rsb_bridge.link.server import Entry, Server, ServerLink
    from rsb_bridge.model.session import Session, Topic
    from rsb_bridge.route.route import Route

_NOT_IN_FILE = "removed from the session file"


@dataclass(frozen=True, slots=True)
class Step:
    """One change.

    Attributes:
        text: what changes, for an operator.
        apply: does it; may raise `LinkError`, then nothing of this step is done.
    """

    text: str
    apply: Callable[[], object]


def client_steps(link: ClientLink, session: Session, key: Key | None) -> Iterator[Step]:
    """What changes on a client.

    Args:
        link: its link.
        session: as it is to be.
        key: likewise; None: unencrypted.
    """
    if link.key != key:
        effect = "the link is closed, and connects again with the new key"
        yield Step(f"{_key_change(link.key, key)}: {effect}", partial(link.change_key, key))
    yield from _topic_steps(link, session.topics)


def server_steps(server: Server, entries: list[Entry]) -> Iterator[Step]:
    """What changes on a server.

    Args:
        server: with its clients as they are.
        entries: as they are to be.
    """
    wanted = {entry.client.name: entry for entry in entries}
    for name, entry in server.entries.items():
        if name not in wanted:
            effect = "its link is closed, and " if server.links[name].linked else ""
            yield Step(f"client {name}: removed: {effect}it is let in no more", partial(server.remove_client, name))
        elif parts := _client_changes(entry, wanted[name]):
            link = server.links[name]
            effect = _client_effect(link, wanted[name])
            yield Step(f"client {name}: {', '.join(parts)}{effect}", partial(server.change_client, wanted[name]))
    for name, entry in wanted.items():
        if name not in server.entries:
            yield Step(f"client {name}: added, key {_mark(entry.key)}", partial(server.add_client, entry))
            for topic in entry.client.topics:
                yield Step(f"client {name}: {_added(topic)}", partial(_add_to_client, server, name, topic))
        else:
            for step in _topic_steps(server.links[name], entry.client.topics):
                yield Step(f"client {name}: {step.text}", step.apply)


def _client_changes(old: Entry, new: Entry) -> list[str]:
    parts = changes(old.client, new.client, leave_out=("key_file", "topics", "use_name"))
    if old.use_name != new.use_name:
        parts.append(f"use_name {str(old.use_name).lower()} → {str(new.use_name).lower()}")
    if old.key != new.key:
        parts.append(_key_change(old.key, new.key))
    return parts or changes(old.client, new.client, leave_out=("topics",))


def _client_effect(link: ServerLink, new: Entry) -> str:
    effects = []
    if link.linked and link.entry.key != new.key:
        effects.append("its link is closed, and comes back once the client has the new key")
    elif link.linked and link.entry.use_name != new.use_name:
        effects.append("its link is closed, and comes back at once")
    if denied := [route.local_topic for route in link.denied_by(new.client)]:
        effects.append(f"{', '.join(denied)} may not cross any more")
    return f": {'; '.join(effects)}" if effects else ""


# --- the topics that one side of a link proposes


def _topic_steps(link: Link, topics: Iterable[Topic]) -> Iterator[Step]:
    wanted = {_identity(topic): topic for topic in topics}
    routes = {_identity(route.spec): route for route in link.routes.values() if route.proposed_here}
    yielded = {_identity(topic): key for key, topic in link.table.yielded.items()}
    for identity, route in routes.items():
        if identity not in wanted:
            yield Step(_removed(route.spec), partial(_remove, link, identity))
    for identity, key in yielded.items():
        if identity not in wanted:
            yield Step(_removed(link.table.yielded[key]), partial(link.table.yielded.pop, key, None))
    for identity, topic in wanted.items():
        if identity in routes:
            route = routes[identity]
            if route.spec != topic:
                effect = "" if link.can_amend(route, topic) else "; opened anew, counted from 0"
                text = f"{_topic(topic)}: {', '.join(changes(route.spec, topic))}{effect}"
                yield Step(text, partial(_replace, link, topic))
        elif identity in yielded:
            key = yielded[identity]
            if differs := changes(link.table.yielded[key], topic):
                text = f"{_topic(topic)}: {', '.join(differs)}; the client's own entry of it counts"
                yield Step(text, partial(link.table.yielded.__setitem__, key, topic))
        else:
            yield Step(_added(topic), partial(_add, link, topic))


def _added(topic: Topic) -> str:
    return f"{_topic(topic)}: added: {described(topic)}"


def _removed(topic: Topic) -> str:
    return f"{_topic(topic)}: removed (it was {described(topic)})"


def _add(link: Link, topic: Topic) -> None:
    link.add_topic(topic)


def _add_to_client(server: Server, name: str, topic: Topic) -> None:
    if name in server.links:
        server.links[name].add_topic(topic)


def _remove(link: Link, identity: tuple[str, str]) -> None:
    if (route := _proposed(link, identity)) is not None:  # else the other side has removed it meanwhile
        link.table.remove(route, _NOT_IN_FILE)


def _replace(link: Link, topic: Topic) -> None:
    if (route := _proposed(link, _identity(topic))) is not None:
        link.replace_topic(route, topic)
    else:
        link.add_topic(topic)


def _proposed(link: Link, identity: tuple[str, str]) -> Route | None:
    """A topic's route as it is now: steps before this one may have made it anew."""
    routes = (route for route in link.routes.values() if route.proposed_here)
    return next((route for route in routes if _identity(route.spec) == identity), None)


def _topic(topic: Topic) -> str:
    return f"{topic.topic} ({topic.direction})"


def _identity(topic: Topic) -> tuple[str, str]:
    return topic.topic, topic.direction


# --- keys


def _key_change(old: Key | None, new: Key | None) -> str:
    return f"key {_mark(old)} → {_mark(new)}"


def _mark(key: Key | None) -> str:
    return fingerprint(key) if key is not None else "none"
