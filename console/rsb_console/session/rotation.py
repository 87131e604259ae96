"""A client's key, replaced in two steps: the next key is valid beside the old one, until the old one is given up."""

from __future__ import annotations

from pathlib import Path

import msgspec

from rsb_bridge.config.client_entries import ClientError, client_named, with_changed_client
from rsb_bridge.config.files import give_owner
from rsb_bridge.config.keys import copy_key, key_path, read_key, write_key
from rsb_bridge.config.session_file import edited_text, save
from rsb_console.session.clients import (
    Changed,
    check_encrypted,
    check_own_next_key,
    free_key_file,
    key_path_of,
    key_places,
    open_server,
)


def begin_rotation(path: Path, name: str) -> Changed:
    """Make a client's next key, which is valid beside the one that it has. Gives the next key.

    Raises:
        ClientError: there is no such client, no encryption, no key to replace, or a next key already.
        KeyFileError: the key cannot be made.
        SessionError: the file cannot be saved. No key is left then.
    """
    file = open_server(path)
    client = client_named(file.session, name)
    check_encrypted(file)
    current = key_path_of(file, client)
    assert current is not None  # else the session has a mistake
    if (places := key_places(file, client))[1:]:
        raise ClientError(
            f"{name} has a next key already, in {places[1]}: once the robot has it, `rsb-console client rekey {name} "
            f"--finish`; to have one more made, `rsb-console client rekey {name}`, which ends its link"
        )
    key_file = Path(client.key_file or file.session.key_file or "")
    following = str(key_file.with_name(free_key_file(current.parent, f"{key_file.stem}-next")))
    renewed = msgspec.structs.replace(client, next_key_file=following)
    session = with_changed_client(file.session, renewed)
    edited_text(session, path, file)  # before there is a key
    key_at = key_path(path.parent, following)
    key = write_key(key_at)
    try:
        give_owner(key_at, path)
        return Changed(save(session, path, file), renewed, key_at, key)
    except BaseException:
        key_at.unlink()
        raise


def finish_rotation(path: Path, name: str) -> Changed:
    """Give up a client's old key: the next one takes its place, in its file. Gives that one.

    The old key's file is replaced first. If this ends before the session is saved, both files hold the new key, and it
    can be done again.

    Raises:
        ClientError: there is no such client, or it has no next key of its own.
        KeyFileError: the next key cannot be read, or not put in place.
        SessionError: the file cannot be saved.
    """
    file = open_server(path)
    client = client_named(file.session, name)
    check_encrypted(file)
    places = key_places(file, client)
    if not places[1:]:
        raise ClientError(f"{name} has no next key: `rsb-console client rekey {name} --keep-old` makes one")
    check_own_next_key(file.session.next_key_file, client.next_key_file, name)
    current, following = places
    key = read_key(following)
    others = {place for each in file.session.accepted_clients if each.name != name for place in key_places(file, each)}
    is_shared = current in others
    key_file = client.next_key_file if is_shared else client.key_file
    renewed = msgspec.structs.replace(client, key_file=key_file, next_key_file=None)
    session = with_changed_client(file.session, renewed)
    edited_text(session, path, file)
    if not is_shared:
        copy_key(key, current, force=True)
    saved = save(session, path, file)
    if not is_shared:
        following.unlink(missing_ok=True)
    return Changed(saved, renewed, following if is_shared else current, key)
