"""A session in the form of its file, where services, actions and parameters have lists and keys of their own.

`rsb_bridge.model.session` has all of them as topics of another kind, so that they share all code for topics. `KEYS`
defines the entries of each kind, for reading and for writing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import msgspec
from msgspec.structs import FieldInfo, fields

from rsb_bridge.feature import BRINGS, SessionKey, peer_keys, session_keys
from rsb_bridge.model.session import Client, Direction, Kind, Provider, Session, Topic
from rsb_bridge.model.topic_keys import TOPIC_KEYS, ForeignKey

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

LISTS: Final[dict[Kind, str]] = {
    "topic": "topics",
    "service": "services",
    "action": "actions",
    "parameters": "parameters",
}
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


_RENAMED = {"excepts": "except"}
"""Keys of entries that are no names in Python, by the fields of `Topic`."""
_FIELDS = [field.name for field in fields(Topic) if field.name in TOPIC_KEYS]


def _keys(name: str) -> dict[str, str]:
    known = (field for field in _FIELDS if TOPIC_KEYS[field].kinds == "all")
    renamed = _RENAMED | {"topic": name, "direction": "provider", "remote_topic": f"remote_{name}"}
    keys = {renamed.get(field, field): field for field in known if not (name == "node" and field == "type")}
    first = [name, "provider", *(["type"] if "type" in keys else [])]
    return {key: keys[key] for key in first} | {"timeout": "timeout"} | keys


KEYS: Final[dict[Kind, dict[str, str]]] = {
    "topic": {_RENAMED.get(field, field): field for field in _FIELDS if TOPIC_KEYS[field].is_of("topic")},
    "service": _keys("service"),
    "action": _keys("action"),
    "parameters": _keys("node"),
}
"""The fields of `Topic` by the keys of an entry, in the order in which one is written."""

_KEY_OF = {kind: {field: key for key, field in keys.items()} for kind, keys in KEYS.items()}


_NOT_OF_TOPICS = {
    "kind": ForeignKey.KIND_OF_TOPIC(),
    **{name: key.wrong_kind() for name, key in TOPIC_KEYS.items() if key.kinds == "calls"},
    "provider": ForeignKey.PROVIDER_OF_TOPIC(),
    **{key: ForeignKey.NOT_A_TOPIC(list=name) for name, key in NAME_KEYS.items() if name != "topics"},
}
_NOT_OF_CALLS = {
    "kind": ForeignKey.KIND_OF_CALLED(),
    "direction": ForeignKey.DIRECTION_OF_CALLED(),
    **{name: key.wrong_kind() for name, key in TOPIC_KEYS.items() if key.kinds == "topics"},
}


def hints_of(kind: Kind) -> dict[str, str]:
    """Return the remedies for keys that only entries of other kinds have."""
    if kind == "topic":
        return _NOT_OF_TOPICS
    name = NAME_KEYS[LISTS[kind]]
    hints = _NOT_OF_CALLS | {
        key: ForeignKey.LIST_UNDER(list=other, key=name) for other, key in NAME_KEYS.items() if key != name
    }
    hints |= {
        f"remote_{key}": ForeignKey.OTHER_REMOTE(key=f"remote_{name}") for key in NAME_KEYS.values() if key != name
    }
    return hints | ({"type": ForeignKey.TYPE_OF_PARAMETERS()} if kind == "parameters" else {})


def _entry(kind: Kind) -> type[msgspec.Struct]:
    known = {field.name: field for field in fields(Topic)}
    own = [
        _field(key, Provider if key == "provider" else known[field].type, known[field])
        for key, field in KEYS[kind].items()
    ]
    return _struct(kind.capitalize(), own, hints_of(kind))


def _field(name: str, kind: Any, like: FieldInfo) -> Any:
    return (name, kind) if like.required else (name, kind, like.default)


def _struct(name: str, own: list[Any], hints: Mapping[str, str]) -> type[msgspec.Struct]:
    return msgspec.defstruct(
        name, own, frozen=True, forbid_unknown_fields=True, omit_defaults=True, namespace={"hints": hints}
    )  # fmt: skip


_ENTRIES: dict[Kind, type[msgspec.Struct]] = {kind: _entry(kind) for kind in LISTS}


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
    absent = {key: ForeignKey.OF_FEATURE(feature=name) for key, name in BRINGS.items() if key not in _FEATURE_KEYS}
    return _struct(model.__name__, own, absent)


_CLIENT = _holder(Client)
SESSION_FILE = _holder(Session, clients=tuple[_CLIENT, ...] | None)  # type: ignore[valid-type]
"""`Session` with lists for each kind, here and in its clients."""


def key_of(kind: Kind, field: str) -> str:
    """Return the key of a field of `Topic` in an entry of a kind, or the field's name if the kind lacks it."""
    return _KEY_OF[kind].get(field, field)


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


def _foreign_of(kind: Kind) -> dict[str, tuple[Any, str]]:
    own, hints = set(KEYS[kind].values()) | {"kind"}, hints_of(kind)
    return {
        field.name: (field.default, hints.get(field.name, ForeignKey.OTHER()))
        for field in fields(Topic)
        if field.name not in own
    }


_FOREIGN = {kind: _foreign_of(kind) for kind in LISTS}
"""The fields that a kind cannot have, each with its default and the remedy."""


def foreign(topic: Topic) -> dict[str, str]:
    """Return the fields of a topic that its kind cannot have, each with the remedy."""
    known = _FOREIGN[topic.kind].items()
    return {field: remedy for field, (default, remedy) in known if getattr(topic, field) != default}


def as_written(value: msgspec.Struct) -> msgspec.Struct:
    """Return a session, a client or a topic as its file has it; any other struct as it is."""
    if isinstance(value, Topic):
        return _ENTRIES[value.kind](**{key: _written(value, key, field) for key, field in KEYS[value.kind].items()})
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


def _written(topic: Topic, key: str, field: str) -> Any:
    value = getattr(topic, field)
    return _PROVIDERS.get(value, value) if key == "provider" else value


def as_session(written: msgspec.Struct) -> Session:
    """Return the session that a file says, given as `SESSION_FILE`."""
    given = _given(written, Session)
    listed = given["clients"]
    clients = None if listed is None else tuple(Client(**_given(client, Client)) for client in listed)
    return Session(**given | {"clients": clients})


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


def as_topic(kind: Kind, written: msgspec.Struct) -> Topic:
    """Return the topic that an entry of a file says."""
    given = {field: getattr(written, key) for key, field in KEYS[kind].items()}
    # A topic's entry has its direction itself.
    return Topic(**given | {"direction": DIRECTIONS.get(given["direction"], given["direction"])}, kind=kind)


def _given(written: msgspec.Struct, model: type[Session | Client]) -> dict[str, Any]:
    """Return the fields of a session or a client, with the entries of all lists in one."""
    lists = LISTS.values()
    given = {name: getattr(written, name) for name in written.__struct_fields__ if name not in lists}
    topics = (as_topic(kind, entry) for kind, name in LISTS.items() for entry in getattr(written, name))
    features = as_said({name: given.pop(name) for name in _KEYS_OF[model]})
    return given | {"topics": tuple(topics), "features": features}
