"""The clients of a server's session: one more, another in one's place, one less."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from rsb_bridge.model.session import Client, Session


class ClientProblem(Wording):
    """The reason why a server's list of clients cannot be changed so."""

    EXISTS = "{name} is a client already; `client rekey {name}` makes a new key for it"
    UNKNOWN = "{name} is no client of this server; its clients: {names}"
    MISSPELT = "{name} is no client of this server; did you mean {near}?"
    NOT_A_SERVER = "only a server has clients, and this is a client's session"


class ClientError(ValueError):
    """A server's list of clients cannot be changed so. The message names the remedy."""


def with_client(session: Session, client: Client) -> Session:
    """Add a client to a server's session.

    Raises:
        ClientError: it has a client of that name.
    """
    clients = _clients(session)
    if any(each.name == client.name for each in clients):
        raise ClientError(ClientProblem.EXISTS(name=client.name))
    # Without a list of clients, `bench` is of the only one, whose entry has it now (`Session.accepted_clients`).
    return msgspec.structs.replace(session, clients=(*clients, client), bench=None)


def with_changed_client(session: Session, client: Client) -> Session:
    """Replace the entry of a client in a server's session.

    Raises:
        ClientError: it has no client of that name.
    """
    old = client_named(session, client.name)
    clients = tuple(client if each == old else each for each in _clients(session))
    return msgspec.structs.replace(session, clients=clients, bench=None)


def without_client(session: Session, name: str) -> Session:
    """Return a server's session without one of its clients.

    Raises:
        ClientError: there is no such client.
    """
    old = client_named(session, name)
    clients = tuple(each for each in _clients(session) if each != old)
    return msgspec.structs.replace(session, clients=clients, bench=None)


def client_named(session: Session, name: str) -> Client:
    """Find a client of a server by its name.

    Raises:
        ClientError: the server has no client of that name.
    """
    clients = _clients(session)
    names = [each.name for each in clients]
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1)
        if near:
            raise ClientError(ClientProblem.MISSPELT(name=name, near=near[0]))
        raise ClientError(ClientProblem.UNKNOWN(name=name, names=", ".join(names) or "none"))
    return clients[names.index(name)]


def _clients(session: Session) -> tuple[Client, ...]:
    if session.role != "server":
        raise ClientError(ClientProblem.NOT_A_SERVER())
    return session.accepted_clients
