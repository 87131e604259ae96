"""Changes of a session: of a server's list of clients, of what a running bridge can change, and in words."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.config.file_form import LISTS, NOUNS, as_said, as_written
from rsb_bridge.config.yaml_text import inline
from rsb_bridge.model.session import Session, Topic, session_keys
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Collection

    from rsb_bridge.model.session import Client


class ChangeRefused(Wording):
    """The reason why a running bridge keeps something of its session."""

    OTHER_SESSION = "{differences}: that is another session; {restart}"
    RESTART = "restart the bridge's process for that (systemctl restart, or rsb-console stop and start it again)"


_OTHER_SESSION = ("name", "role")
_FIXED = ("server_ip", "server_port", "bluetooth_address", "domain_id", "use_encryption", "profile")
_FIXED_ON_CLIENT = (*_FIXED, "use_name")
_LISTS_OF_SESSION = frozenset((*LISTS.values(), "clients"))


def is_another(old: Session, new: Session) -> str:
    """Return the reason why a running bridge cannot change to another session, or an empty string."""
    differences = changes(old, new, only=_OTHER_SESSION)
    if not differences:
        return ""
    return ChangeRefused.OTHER_SESSION(differences="; ".join(differences), restart=ChangeRefused.RESTART())


def kept(old: Session, new: Session) -> tuple[Session, list[str]]:
    """Return the session that a running bridge can change to, and in words what it leaves as it is."""
    fixed = _FIXED_ON_CLIENT if old.role == "client" else _FIXED
    keys = [key for key in session_keys().values() if not key.live]
    differences = changes(old, new, only=(*fixed, *(key.name for key in keys)))
    restart = ChangeRefused.RESTART()
    left = [f"{change}: cannot change while the bridge runs; {restart}" for change in differences]
    features = as_said(new.features | {key.name: key.of(old) for key in keys})
    others = {name: getattr(old, name) for name in fixed}
    return msgspec.structs.replace(new, **others, features=features), left


def changes(
    old: msgspec.Struct, new: msgspec.Struct, *, only: Collection[str] = (), leave_out: Collection[str] = ()
) -> list[str]:
    """Return the fields that differ: ``max_rate none → 5.0``.

    Args:
        old: a session, a topic or a client.
        new: the same with changes.
        only: the fields to compare, or empty for all.
    """
    if isinstance(old, Session) and only and _LISTS_OF_SESSION.isdisjoint(only):  # which take long to write
        old, new = (msgspec.structs.replace(each, topics=(), clients=None) for each in (old, new))
    # In the words of the file. Entries of two kinds have different ones.
    if isinstance(old, Session) or (isinstance(old, Topic) and isinstance(new, Topic) and old.kind == new.kind):
        old, new = as_written(old), as_written(new)
    found = []
    for name in only or new.__struct_fields__:
        before, after = getattr(old, name), getattr(new, name)
        if name in leave_out or before == after:
            continue
        key = session_keys().get(name)
        if key is not None and key.hidden_as:
            was, becomes = (f"{word} {key.hidden_as}" for word in ("a", "another"))
            was, becomes = was if before else "none", becomes if after else "none"
        else:
            was, becomes = _value(before), _value(after)
        found.append(f"{name} {was} → {becomes}")
    return found


def values_apart(here: Topic, there: Topic, *, leave_out: Collection[str]) -> tuple[str, str]:
    """Return what differs between two entries of one kind, as each has it: ``max_rate 5`` and ``max_rate 10``."""
    written = as_written(here), as_written(there)
    names = [
        name
        for name in written[0].__struct_fields__
        if name not in leave_out and getattr(written[0], name) != getattr(written[1], name)
    ]
    mine, theirs = (", ".join(f"{name} {_value(getattr(each, name))}" for name in names) for each in written)
    return mine, theirs


def named(topic: Topic) -> str:
    """Return a topic among the others of its session: ``/scan (transmit)``, ``service /dock (provider: server)``."""
    if topic.kind == "topic":
        return f"{topic.topic} ({topic.direction})"
    return f"{NOUNS[LISTS[topic.kind]]} {topic.topic} (provider: {topic.provider})"


def described(entry: Topic) -> str:
    """Return an entry as a session file would have it: ``{topic: /scan, direction: transmit}``."""
    return inline(msgspec.to_builtins(as_written(entry)))


def _value(value: Any) -> str:
    return "none" if value is None else inline(msgspec.to_builtins(value))


class ClientProblem(Wording):
    """The reason why a server's list of clients cannot be changed so."""

    EXISTS = "{name} is a client already; `client rekey {name}` makes a new key for it"
    UNKNOWN = "{name} is no client of this server; its clients: {names}"
    MISSPELT = "{name} is no client of this server; did you mean {near}?"
    NOT_A_SERVER = "only a server has clients, and this is a client's session"


class ClientError(ValueError):
    """A server's list of clients cannot be changed so. The message names the remedy."""


# --- a server's list of clients. All functions raise a ClientError if the session has no such list


def with_client(session: Session, client: Client) -> Session:
    """Add a client. One of that name is a ClientError, too."""
    clients = _clients(session)
    if any(each.name == client.name for each in clients):
        raise ClientError(ClientProblem.EXISTS(name=client.name))
    return session.with_clients((*clients, client))


def with_changed_client(session: Session, client: Client) -> Session:
    """Replace the entry of the client of that name."""
    old = client_named(session, client.name)
    return session.with_clients(tuple(client if each == old else each for each in _clients(session)))


def without_client(session: Session, name: str) -> Session:
    old = client_named(session, name)
    return session.with_clients(tuple(each for each in _clients(session) if each != old))


def client_named(session: Session, name: str) -> Client:
    """Find a client by its name. None of that name is a ClientError, too."""
    clients = _clients(session)
    names = [each.name for each in clients]
    if name in names:
        return clients[names.index(name)]
    if near := difflib.get_close_matches(name, names, n=1):
        raise ClientError(ClientProblem.MISSPELT(name=name, near=near[0]))
    raise ClientError(ClientProblem.UNKNOWN(name=name, names=", ".join(names) or "none"))


def _clients(session: Session) -> tuple[Client, ...]:
    if session.role != "server":
        raise ClientError(ClientProblem.NOT_A_SERVER())
    return session.accepted_clients
