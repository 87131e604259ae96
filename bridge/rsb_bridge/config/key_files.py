"""The rules of a session's key files: the one of each client, and the one that replaces it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.decoding import join, show
from rsb_bridge.model.session import Problem

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.session import Client, Session


def key_file_problems(session: Session) -> Iterator[Problem]:
    """All mistakes in a session's key files, as far as can be told without reading them."""
    yield from _names(session, "")
    yield from _replaces(session.next_key_file, session.key_file, "")
    owners: list[tuple[str, str | None]] = []
    for at, client in enumerate(session.clients):
        location = join("clients", at)
        owners.append((location, client.key_file))
        yield from _names(client, location)
        yield from _replaces(client.next_key_file, client.key_file or session.key_file, location)
    if session.role == "client" and session.next_key_file is not None:
        yield Problem(
            "next_key_file",
            "belongs in the server's session file, where two keys may be valid: here, replace the file that key_file "
            "names, and reload",
        )
    if session.use_encryption and session.key_file is None:
        for location, key_file in owners or [("", None)]:
            if key_file is None:
                yield Problem(
                    join(location, "key_file"),
                    "missing: encryption needs a key; make one with `rsb-console keygen` and give its file's name",
                )


def _names(entry: Session | Client, location: str) -> Iterator[Problem]:
    for key, name in (("key_file", entry.key_file), ("next_key_file", entry.next_key_file)):
        if name is not None and not (name.strip() and name.isprintable()):
            yield Problem(join(location, key), f"{show(name)} is not a file name: give the key file's")


def _replaces(following: str | None, current: str | None, location: str) -> Iterator[Problem]:
    """Mistakes in the key file that is to replace another one."""
    if following is None:
        return
    if current is None:
        yield Problem(
            join(location, "next_key_file"), "there is no key_file beside it, which it would replace: give that one"
        )
    elif following == current:
        yield Problem(
            join(location, "next_key_file"), f"{show(following)} is the key_file already: give the new key's file"
        )
