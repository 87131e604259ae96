"""A session in the form of its file, where services, actions and parameters have lists and keys of their own.

`rsb_bridge.model.session` has all of them as topics of another kind, so that they share all code for topics. The
entries of each kind, for reading and for writing, follow from `rsb_bridge.model.topic_keys`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import msgspec
from msgspec.structs import FieldInfo, fields

from rsb_bridge.feature import BRINGS, SessionKey
from rsb_bridge.model.session import (
    AbsentFeature,
    Client,
    Direction,
    Kind,
    Provider,
    Session,
    Topic,
    peer_keys,
    session_keys,
)
from rsb_bridge.model.topic_keys import ADDED_KEYS, TOPIC_KEYS, ForeignKey, type_of, without_defaults

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_EXACT = 1e15
"""Whole numbers below it are floats exactly, and are written with all their digits."""
LISTS: Final[dict[Kind, str]] = {
    "topic": "topics", "service": "services", "action": "actions", "parameters": "parameters",
}  # fmt: skip
"""Where a session file lists each kind."""
NAME_KEYS: Final[dict[str, str]] = {"topics": "topic", "services": "service", "actions": "action", "parameters": "node"}
"""The key of an entry's name, by list."""
NOUNS: Final[dict[str, str]] = {
    "topics": "topic", "services": "service", "actions": "action", "parameters": "parameters of", "clients": "client",
    "operators": "operator",
}  # fmt: skip
"""What an entry is called, before its name, by list."""
_PROVIDERS: dict[Any, Provider] = {"transmit": "server", "receive": "client"}
DIRECTIONS: Final[dict[Any, Direction]] = {provider: direction for direction, provider in _PROVIDERS.items()}
"""The direction of requests, by which side's node answers."""


def _renamed(name: str) -> dict[str, str]:
    """Return the keys of calls that have other names than their fields; `name` is that of the called."""
    return {"topic": name, "direction": "provider", "remote_topic": f"remote_{name}", "excepts": "except"}


_RENAMED: Final[dict[Kind, dict[str, str]]] = {
    kind: {"excepts": "except"} if kind == "topic" else _renamed(NAME_KEYS[name]) for kind, name in LISTS.items()
}
KEYS: Final[dict[Kind, dict[str, str]]] = {
    kind: {
        _RENAMED[kind].get(field, field): field
        for field in (*Topic.__struct_fields__, *ADDED_KEYS)
        if field in TOPIC_KEYS and TOPIC_KEYS[field].is_of(kind)
    }
    for kind in LISTS
}
"""The names of `TOPIC_KEYS` by the keys of an entry, in the order in which one is written."""

_NOT_OF_TOPICS = {
    "kind": ForeignKey.KIND_OF_TOPIC(),
    "timeout": ForeignKey.TIMEOUT_OF_TOPIC(),
    "provider": ForeignKey.PROVIDER_OF_TOPIC(),
    "service": ForeignKey.NOT_A_TOPIC(list="services"),
    "action": ForeignKey.NOT_A_TOPIC(list="actions"),
    "node": ForeignKey.NOT_A_TOPIC(list="parameters"),
}
_NOT_OF_CALLS = {
    "kind": ForeignKey.KIND_OF_CALLED(),
    "direction": ForeignKey.DIRECTION_OF_CALLED(),
    "qos": ForeignKey.QOS_OF_CALLED(),
    "expected_rate": ForeignKey.EXPECTED_RATE_OF_CALLED(),
    "stale_after": ForeignKey.STALE_AFTER_OF_CALLED(),
    "late_after": ForeignKey.LATE_AFTER_OF_CALLED(),
    "keep": ForeignKey.KEEP_OF_CALLED(),
    "priority": ForeignKey.PRIORITY_OF_CALLED(),
}


def hints_of(kind: Kind) -> dict[str, str]:
    """Return the remedies for keys that only entries of other kinds have."""
    others_only = ForeignKey.OF_CALLS_ONLY() if kind == "topic" else ForeignKey.OF_TOPICS_ONLY()
    usual = {name: others_only for name, key in TOPIC_KEYS.items() if not key.is_of(kind)}
    if kind == "topic":
        return usual | _NOT_OF_TOPICS
    name = NAME_KEYS[LISTS[kind]]
    others = [(other, key) for other, key in NAME_KEYS.items() if key != name]
    hints = usual | _NOT_OF_CALLS
    hints |= {key: ForeignKey.LIST_UNDER(list=other, key=name) for other, key in others}
    hints |= {f"remote_{key}": ForeignKey.OTHER_REMOTE(key=f"remote_{name}") for _, key in others}
    return hints | ({"type": ForeignKey.TYPE_OF_PARAMETERS()} if kind == "parameters" else {})


# --- the structs of a file


def _field(name: str, kind: Any, like: FieldInfo) -> Any:
    return (name, kind) if like.required else (name, kind, like.default)


def _struct(name: str, own: list[Any], hints: Mapping[str, str]) -> type[msgspec.Struct]:
    return msgspec.defstruct(
        name, own, frozen=True, forbid_unknown_fields=True, omit_defaults=True, namespace={"hints": hints}
    )  # fmt: skip


_FIELDS = {field.name: field for field in fields(Topic)}
_ENTRIES: dict[Kind, type[msgspec.Struct]] = {
    kind: _struct(
        kind.capitalize(),
        [
            _field(key, Provider if key == "provider" else _FIELDS[field].type, _FIELDS[field])
            for key, field in keys.items()
            if field in _FIELDS
        ]
        + [(key, type_of(ADDED_KEYS[key]), ADDED_KEYS[key].default) for key in keys if key in ADDED_KEYS],
        hints_of(kind),
    )
    for kind, keys in KEYS.items()
}
_FEATURE_KEYS = session_keys()
_KEYS_OF: dict[type, Mapping[str, SessionKey[Any]]] = {Session: _FEATURE_KEYS, Client: peer_keys()}


def _holder(model: type[msgspec.Struct], **others: Any) -> type[msgspec.Struct]:
    """Return a session or a client with a list for each kind."""
    own: list[Any] = []
    for field in fields(model):
        if field.name == "topics":
            own += [(name, tuple[_ENTRIES[kind], ...], ()) for kind, name in LISTS.items()]  # type: ignore[valid-type]
        elif field.name == "features":
            own += [(key.name, key.type, key.default) for key in _KEYS_OF[model].values()]
        else:
            own.append(_field(field.name, others.get(field.name, field.type), field))
    absent = {key: AbsentFeature.KEY(feature=name) for key, name in BRINGS.items() if key not in _FEATURE_KEYS}
    return _struct(model.__name__, own, absent)


_CLIENT = _holder(Client)
SESSION_FILE = _holder(Session, clients=tuple[_CLIENT, ...] | None)  # type: ignore[valid-type]
"""`Session` with lists for each kind, here and in its clients."""


# --- topics and their entries

_KEYS_OF_FIELDS = {kind: {field: key for key, field in keys.items()} for kind, keys in KEYS.items()}


def key_of(kind: Kind, field: str) -> str:
    """Return the key of a field of `Topic` in an entry of a kind, or the field's name if the kind lacks it."""
    return _KEYS_OF_FIELDS[kind].get(field, field)


def field_of(kind: Kind, key: str) -> str:
    """Return the field of a key; the inverse of `key_of`."""
    return KEYS[kind].get(key, key)


def locations(topics: Sequence[Topic]) -> list[str]:
    """Return the locations of the topics of a session or a client in its file: ``services[2]``."""
    counted = dict.fromkeys(LISTS, 0)
    found = []
    for topic in topics:
        found.append(f"{LISTS[topic.kind]}[{counted[topic.kind]}]")
        counted[topic.kind] += 1
    return found


_FOREIGN = {
    kind: {
        name: (field.default, hints_of(kind)[name])
        for name, field in _FIELDS.items()
        if name not in keys.values() and name not in ("kind", "features")
    }
    for kind, keys in KEYS.items()
}
"""The fields that a kind cannot have, each with its default and the remedy."""


def foreign(topic: Topic) -> dict[str, str]:
    """Return the fields of a topic that its kind cannot have, each with the remedy."""
    known = _FOREIGN[topic.kind].items()
    found = {field: remedy for field, (default, remedy) in known if getattr(topic, field) != default}
    if topic.features:
        hints = hints_of(topic.kind)
        found |= {name: hints[name] for name in topic.features if name in hints}
    return found


def as_topic(kind: Kind, written: msgspec.Struct) -> Topic:
    """Return the topic that an entry of a file says."""
    given = {field: getattr(written, key) for key, field in KEYS[kind].items()}
    if ADDED_KEYS:
        given["features"] = without_defaults({name: given.pop(name) for name in ADDED_KEYS if name in given})
    # A topic's entry has its direction itself.
    return Topic(**given | {"direction": DIRECTIONS.get(given["direction"], given["direction"])}, kind=kind)


def as_written(value: msgspec.Struct) -> msgspec.Struct:
    """Return a session, a client or a topic as its file has it; any other struct as it is."""
    if isinstance(value, Topic):
        given = {
            key: ADDED_KEYS[field].of(value) if field in ADDED_KEYS else getattr(value, field)
            for key, field in KEYS[value.kind].items()
        }
        if "provider" in given:
            given["provider"] = _PROVIDERS.get(given["provider"], given["provider"])
        return _ENTRIES[value.kind](**given)
    if not isinstance(value, Session | Client):
        return value
    model = SESSION_FILE if isinstance(value, Session) else _CLIENT
    given = {name: getattr(value, name) for name in value.__struct_fields__ if name not in ("topics", "features")}
    given |= {
        name: tuple(as_written(topic) for topic in value.topics if topic.kind == kind) for kind, name in LISTS.items()
    }
    if isinstance(value, Session):
        given["clients"] = None if value.clients is None else tuple(map(as_written, value.clients))
    return model(**given | {name: key.of(value) for name, key in _KEYS_OF[type(value)].items()})


def as_plain(written: Any) -> Any:
    """Return what a file says as plain data, in which whole numbers are written as such: ``5``, not ``5.0``."""
    return _whole(msgspec.to_builtins(written))


def _whole(value: Any) -> Any:
    if isinstance(value, float) and value.is_integer() and abs(value) < _EXACT:
        return int(value)
    if isinstance(value, dict):
        return {key: _whole(each) for key, each in value.items()}
    return [_whole(each) for each in value] if isinstance(value, list | tuple) else value


# --- sessions


def as_session(written: msgspec.Struct) -> Session:
    """Return the session that a file says, given as `SESSION_FILE`."""

    def given(holder: msgspec.Struct, model: type[Session | Client]) -> dict[str, Any]:
        topics = (as_topic(kind, entry) for kind, name in LISTS.items() for entry in getattr(holder, name))
        said = {name: getattr(holder, name) for name in holder.__struct_fields__ if name not in LISTS.values()}
        features = as_said({name: said.pop(name) for name in _KEYS_OF[model]})
        return said | {"topics": tuple(topics), "features": features}

    said = given(written, Session)
    if (listed := said["clients"]) is not None:
        said["clients"] = tuple(Client(**given(client, Client)) for client in listed)
    return Session(**said)


def with_types(session: Session) -> Session:
    """Return a session that came as plain data, with the values of features' keys in their types.

    Raises:
        msgspec.ValidationError: a value has another one.
    """

    def typed(holder: Session | Client) -> dict[str, Any]:
        known, given = _KEYS_OF[type(holder)], holder.features.items()
        return {name: msgspec.convert(value, known[name].type) for name, value in given if name in known}

    clients = session.clients
    if clients is not None:
        clients = tuple(msgspec.structs.replace(each, features=typed(each)) for each in clients)
    return msgspec.structs.replace(session, features=typed(session), clients=clients)


def as_said(features: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of features' keys that differ from their defaults."""
    return {name: value for name, value in features.items() if value != _FEATURE_KEYS[name].default}
