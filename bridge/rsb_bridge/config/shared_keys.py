"""Clients of one server that have the same key: each could take the other's name, and so its rights."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.keys import KeyFileError, keys_of
from rsb_bridge.model.text import join_first

if TYPE_CHECKING:
    from collections.abc import Collection, Hashable, Mapping
    from pathlib import Path

    from rsb_bridge.config.keys import Key
    from rsb_bridge.model.session import Session

_NAMED = 5


def unshared_keys(session: Session, base: Path) -> dict[str, tuple[Key, ...]]:
    """As `rsb_bridge.config.keys.keys_of`, of clients that may have them.

    Raises:
        KeyFileError: one is not there or holds no key, or two clients have the same.
    """
    keys = keys_of(session, base)
    if problem := shared_key_problem(session, keys):
        raise KeyFileError(problem)
    return keys


def shared_key_problem(session: Session, keys: Mapping[str, Collection[Hashable]]) -> str:
    """Why a server must not let its clients in with these keys, and what to do; empty: it may.

    Args:
        session: a server's; it may say that the clients are meant to share keys.
        keys: what is the same for two clients if a key of theirs is, for each key that is valid, by the clients' names.
    """
    if session.shared_keys:
        return ""
    owners: dict[Hashable, list[str]] = {}
    for name, valid in keys.items():
        for key in dict.fromkeys(valid):
            owners.setdefault(key, []).append(name)
    shared = [f"{join_first(names, _NAMED)} have one key" for names in owners.values() if len(names) > 1]
    if not shared:
        return ""
    return (
        f"{'; '.join(shared)}: whoever has it may take each of these names, and its rights. Give each a key of its own "
        "(`rsb-console client rekey NAME SESSION`), or say `shared_keys: true` in the server's session file"
    )
