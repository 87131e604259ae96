"""Features of the control socket that its first version lacks, and messages for a side that lacks some. Sans-IO.

Bridges and consoles of different ages attach to each other, and each ends the connection if it gets a command or a
field of a session that it does not know. So both name their features when they attach: a console does not send what
the bridge does not know, and a bridge leaves out what the console does not know.
"""

from __future__ import annotations

import functools
import operator
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

import msgspec

from rsb_bridge import __version__
from rsb_bridge.control.protocol import VERSION, Hello
from rsb_bridge.model.commands import (
    Acknowledge,
    AnyCommand,
    ChangeClient,
    Command,
    DraftMessage,
    EditTopic,
    EndLook,
    Look,
    Publish,
    RemoveTopic,
)
from rsb_bridge.model.session import Client, Session, Topic

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rsb_bridge.model.snapshot import Snapshot

ACKNOWLEDGE = "acknowledge"
"""The command `Acknowledge`."""
ARMED = "armed"
"""The field `armed` of sessions, and `drop_arm` of commands."""
LOOK = "look"
"""The commands `Look` and `EndLook`."""
PUBLISH = "publish"
"""The commands `DraftMessage` and `Publish`."""
TOTALS = "totals"
"""The field `messages_total` of routes."""
FEATURES: Final = (
    ACKNOWLEDGE, ARMED, "check_messages", "late_after", LOOK, "max_age", "on_end", "on_fault", PUBLISH, TOTALS
)  # fmt: skip
"""All features of this version. A feature with the name of a field of sessions or topics is that field."""

COMMANDS: Final[dict[type, str]] = {
    Acknowledge: ACKNOWLEDGE,
    DraftMessage: PUBLISH,
    EndLook: LOOK,
    Look: LOOK,
    Publish: PUBLISH,
}
"""The features of commands."""
FIELDS: Final[dict[type, dict[str, str]]] = {
    Topic: {name: name for name in FEATURES if name in Topic.__struct_fields__},
    Session: {name: name for name in FEATURES if name in Session.__struct_fields__},
    EditTopic: {"drop_arm": ARMED},
    RemoveTopic: {"drop_arm": ARMED},
}
"""The features of fields."""

_ALL = frozenset(FEATURES)
_LACKS: Final = {
    ACKNOWLEDGE: "cannot acknowledge faults",
    ARMED: "cannot end the demand that a name be armed",
    LOOK: "cannot draw pictures of messages",
    PUBLISH: "cannot publish messages by hand",
    TOTALS: "does not report message counts",
}

V = TypeVar("V")


def hello(*, read_only: bool) -> Hello:
    """Return the greeting of a console of this version; `read_only` asks the bridge to refuse changes."""
    return Hello(VERSION, __version__, read_only, FEATURES)


def known_features(named: Iterable[str]) -> frozenset[str]:
    """Return the features of the other side that this version knows."""
    return _ALL.intersection(named)


def knows_all(features: frozenset[str]) -> bool:
    """Whether the other side has all features of this version."""
    return features >= _ALL


def missing_feature(command: Command[object], features: frozenset[str]) -> str:
    """Return a feature that a command needs and the bridge lacks, or an empty string."""
    return next((feature for feature in _features_of(command) if feature not in features), "")


def older_bridge_text(name: str, feature: str, version: str = "") -> str:
    """Tell an operator that a bridge lacks a feature, and what to do.

    Args:
        name: of the bridge.
        feature: that it lacks.
        version: of its rsb-console, or empty if that tells nothing.
    """
    which = f" ({version})" if version else ""
    lack = _LACKS.get(feature, f"has no {feature}")
    return f"{name} runs an older rsb-console{which}, which {lack}: update and restart it"


def without_unknown(value: V, features: frozenset[str]) -> V:
    """Return a session, or a part of one, without the fields that the other side does not know.

    The same object is returned if nothing is left out.
    """
    if knows_all(features):
        return value
    if isinstance(value, tuple):
        parts = tuple(without_unknown(each, features) for each in value)
        return value if all(map(operator.is_, parts, value)) else cast("V", parts)
    if not isinstance(value, (Session, Client, Topic)):
        return value
    kind: type = type(value)
    changes = {
        name: default
        for name, feature, default in _new_fields(kind)
        if feature not in features and getattr(value, name) != default
    }
    for name in _PARTS.get(kind, ()):
        part = getattr(value, name)
        if (shortened := without_unknown(part, features)) is not part:
            changes[name] = shortened
    return cast("V", msgspec.structs.replace(value, **changes)) if changes else value


def with_unknown_kept(
    command: AnyCommand, features: frozenset[str], snapshot: Snapshot, session: Session
) -> AnyCommand:
    """Return a command of an older console, in which fields that the console does not know keep their values.

    Args:
        command: as it came.
        features: of the console.
        snapshot: the newest.
        session: the present one.
    """
    if isinstance(command, EditTopic) and (before := _spec(snapshot, command.key)) is not None:
        return msgspec.structs.replace(command, topic=_kept(command.topic, before, features))
    if isinstance(command, ChangeClient):
        client = command.client
        entries = (each.topics for each in session.listed_clients if each.name == client.name)
        before_of = {each.identity: each for each in next(entries, ())}
        topics = tuple(_kept(each, before_of.get(each.identity, each), features) for each in client.topics)
        return msgspec.structs.replace(command, client=msgspec.structs.replace(client, topics=topics))
    return command


_PARTS: Final[dict[type, tuple[str, ...]]] = {Session: ("topics", "clients"), Client: ("topics",)}
"""The fields that hold topics and clients."""


@functools.cache  # the types of all commands and sessions: a few dozen
def _new_fields(kind: type) -> tuple[tuple[str, str, Any], ...]:
    """Return the fields that belong to a feature, each with the feature and the field's default."""
    defaults = {each.name: each.default for each in msgspec.structs.fields(kind)}
    return tuple([(name, feature, defaults[name]) for name, feature in FIELDS.get(kind, {}).items()])


def _features_of(value: object) -> Iterator[str]:
    """Yield the features that a command or a part of one needs."""
    if isinstance(value, tuple):
        for each in value:
            yield from _features_of(each)
    elif isinstance(value, msgspec.Struct):
        kind = type(value)
        if kind in COMMANDS:
            yield COMMANDS[kind]
        yield from (feature for name, feature, default in _new_fields(kind) if getattr(value, name) != default)
        for name in kind.__struct_fields__:
            yield from _features_of(getattr(value, name))


def _spec(snapshot: Snapshot, key: str) -> Topic | None:
    """Return the entry of a route or a pattern, or None if the key is unknown."""
    patterns = [pattern for link in snapshot.links for pattern in link.patterns]
    entries = [(route.key, route.spec) for route in snapshot.routes] + [(each.key, each.spec) for each in patterns]
    return next((spec for known, spec in entries if known == key), None)


def _kept(topic: Topic, before: Topic, features: frozenset[str]) -> Topic:
    unknown = [name for name, feature, _ in _new_fields(Topic) if feature not in features]
    return msgspec.structs.replace(topic, **{name: getattr(before, name) for name in unknown})
