"""Encryption keys and their files, in the thesis's format: 32 bytes in URL-safe base64, like Fernet's keys.

While a key is replaced, two are valid for a client, until the old one is given up. Clients of one server that have the
same key could each take the other's name, and so its rights.
"""

from __future__ import annotations

import base64
import binascii
import os
import re
import stat
import time
from dataclasses import dataclass, field
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.files import kind_of_file, new_file, replace_file, typed_path, why_not_written
from rsb_bridge.model.fingerprints import fingerprint_of, format_fingerprint
from rsb_bridge.model.text import join_first, plural
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Collection, Hashable, Iterator, Mapping

    from rsb_bridge.model.session import Session

DEFAULT_KEY_FILE = "key.txt"
KEY_BYTES = 32
KEY_LENGTH = 44  # characters, of which a text has to have as many before it is tried as one
DIFFERENT_BYTES = 12
"""Least number of different bytes in a key, and of different steps from one byte to the next: bytes that count up have
one. Of random keys, one in 10^25 has fewer."""
_MAX_FILE = 4096  # bytes; a key file is 45, and one of the thesis has a date before the key
# The second form is a key that lost its padding.
_LIKE_A_KEY = re.compile(r"[A-Za-z0-9+/_-]{43}=|(?<![A-Za-z0-9+/_-])[A-Za-z0-9_-]{43}(?![A-Za-z0-9+/_-])")
_DAY = 86400.0
_LONG = 7 * _DAY  # for which two keys may be valid. A thief of the old key can use it until then
_SPANS = ((_DAY, "day"), (3600.0, "hour"), (60.0, "minute"))
_NAMED = 5


class KeyFileProblem(Wording):
    """The reason why a key file cannot be read or written, or its key must not be used."""

    EXISTS = "{path}: exists already; --force replaces it, and the old key is lost"
    NOT_WRITTEN = "{path}: cannot be written: {problem}"
    NOT_A_FILE = "{path}: is {kind}, not a key file"
    NO_SUCH_FILE = "{path}: no such key file: copy it from the other side, or make one with `rsb-console keygen {path}`"
    TOO_LARGE = "{path}: too large for a key file"
    EMPTY = "{path}: is empty: make a key with `rsb-console keygen`"
    NO_KEY = (
        "{path}: holds no key: a key is 44 characters of URL-safe base64 ({bytes} bytes); the last word of the file "
        "has {length} characters"
    )
    WEAK = (
        "{path}: holds no random key, because its bytes, or the steps between them, have only {count} values: make one "
        "with `rsb-console keygen {path} --force`, and copy it to the other side"
    )
    NOT_GIVEN = "no key_file for {name}: make one with `rsb-console keygen`, and copy it to the other side"
    SHARED = (
        "{owners}: its holder can connect under any of these names, with its rights. Give each its own key "
        "(`rsb-console client rekey NAME SESSION`), or set `shared_keys: true` in the server's session file"
    )
    ONE_KEY = "{names} have the same key"


class KeyWarning(Wording):
    """A risk of a valid key, and its remedy."""

    READABLE = "{path}: others may read this key (mode {mode}): run `chmod 600 {path}`"
    PRINTABLE = (
        "{path}: the key has printable bytes only, so it may be a passphrase that can be guessed: make a new one with "
        "`rsb-console keygen`, and copy it to the other side"
    )
    OTHER_OWNER = (
        "{path}: belongs to another user (uid {uid}), who can read and replace it: make this user its owner (chown)"
    )
    REPLACEABLE = "{path}: other users can replace it: run `chmod o-w {folder}`"
    SAME_NEXT = (
        "{name}: key_file and next_key_file hold the same key, {fingerprint}: "
        "run `rsb-console client rekey {name} --finish`"
    )
    TWO_FOR_LONG = (
        "{name}: two keys have been valid since {since}, and the old one still opens a link: once the robot has the "
        "new one, run `rsb-console client rekey {name} --finish`"
    )


class Age(Wording):
    FUTURE = "in the future: is the clock right?"
    AGO = "{count} {unit} ago"
    NOW = "just now"


class KeyFileError(Exception):
    """A key file cannot be read or written. The message names the file and the remedy."""


@dataclass(frozen=True, slots=True)
class Key:
    """A session key. Its repr shows the fingerprint only, so that no log or message gives the key away."""

    secret: bytes = field(repr=False)  # 32 bytes, the pre-shared key of the handshake
    warnings: tuple[str, ...] = field(default=(), compare=False)  # what an operator should know about its file
    written: float = field(default=0.0, compare=False)  # s since the epoch, when its file was last written

    def __repr__(self) -> str:
        return f"<Key {fingerprint(self)}>"


def generate() -> bytes:
    """Return a new key: 44 characters of URL-safe base64, without a line break."""
    return base64.urlsafe_b64encode(os.urandom(KEY_BYTES))


def is_key(text: str) -> bool:
    return _decode(text) is not None


def is_key_file(text: str) -> bool:
    """Whether a file's text is that of a key file: its last line is a key and nothing else."""
    lines = text.split("\n")
    return is_key(next((line.strip() for line in reversed(lines) if line.strip()), ""))


def conceal(text: str) -> str:
    """Return a text for a message or a log, with every key in it replaced."""
    return _LIKE_A_KEY.sub("<a key>", text)


def fingerprint(key: Key) -> str:
    """Return 16 hexadecimal digits of the key's SHA-256, in fours: operators compare them to see whether keys match."""
    return format_fingerprint(fingerprint_of(key.secret))


def write_key(path: Path, *, force: bool = False, owner: Path | None = None) -> Key:
    """Generate a key and write it to a file, mode 0600.

    Args:
        owner: a file whose owner and group a new file gets.
        force: replace a file that exists. A side with the old key can no longer link.

    Raises:
        KeyFileError: the file exists, or cannot be written.
    """
    key = _parse(generate().decode(), path)
    try:
        _write(key, path, force=force, owner=owner)
    except FileExistsError:
        raise KeyFileError(KeyFileProblem.EXISTS(path=path)) from None
    except OSError as error:
        raise KeyFileError(KeyFileProblem.NOT_WRITTEN(path=path, problem=why_not_written(error, path))) from None
    return key


def copy_key(key: Key, path: Path, *, force: bool = False, owner: Path | None = None) -> None:
    """Write a key to one more file, mode 0600.

    Args:
        owner: as in `write_key`.
        force: replace a file that exists, atomically.

    Raises:
        KeyFileError: the file exists, or cannot be written.
    """
    try:
        _write(key, path, force=force, owner=owner)
    except OSError as error:
        raise KeyFileError(KeyFileProblem.NOT_WRITTEN(path=path, problem=why_not_written(error, path))) from None


def _write(key: Key, path: Path, *, force: bool, owner: Path | None) -> None:
    text = base64.urlsafe_b64encode(key.secret) + b"\n"
    if force:
        replace_file(path, text, owner=owner)
        return
    with new_file(path, owner=owner) as file:
        file.write(text.decode())
        file.flush()
        os.fsync(file.fileno())  # a key without contents after a power cut would lock the peer out


def key_path(base: Path, key_file: str) -> Path:
    """Return the path of a session's key file.

    Args:
        base: the session file's folder.
        key_file: as the session gives it: relative to that folder, absolute, or starting with ``~``.
    """
    return base / typed_path(key_file)


def read_key(path: Path) -> Key:
    """Read a key file. Its last word is the key. Words before it, like the date in the thesis's files, are skipped.

    Raises:
        KeyFileError: the file does not exist, cannot be read, or holds no key.
    """
    try:
        kind = path.stat().st_mode  # before it is opened: a FIFO would wait for a writer
        if not stat.S_ISREG(kind):
            raise KeyFileError(KeyFileProblem.NOT_A_FILE(path=path, kind=kind_of_file(kind)))
        with path.open("rb") as file:
            status = os.fstat(file.fileno())  # of what is read, even if another file is there by now
            content = file.read(_MAX_FILE + 1)
        folder = Path(os.path.realpath(path)).parent
        of_folder = folder.stat().st_mode
    except FileNotFoundError:
        raise KeyFileError(KeyFileProblem.NO_SUCH_FILE(path=path)) from None
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be read: {error.strerror}") from None
    if len(content) > _MAX_FILE:
        raise KeyFileError(KeyFileProblem.TOO_LARGE(path=path))
    key = _parse(content.decode("ascii", errors="replace"), path)
    risks = [*_risks(path, status, folder, of_folder)]
    if all(0x20 <= byte < 0x7F for byte in key.secret):  # of random keys, one in 10^13
        risks.append(KeyWarning.PRINTABLE(path=path))
    return Key(key.secret, tuple(risks), status.st_mtime)


def _risks(path: Path, status: os.stat_result, folder: Path, of_folder: int) -> Iterator[str]:
    """Yield a warning for each way in which other users may read or replace a key. Symbolic links are followed."""
    if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        yield KeyWarning.READABLE(path=path, mode=f"{stat.S_IMODE(status.st_mode):04o}")
    user = os.geteuid()
    if user and status.st_uid not in (user, 0):  # root may read the files of any user
        yield KeyWarning.OTHER_OWNER(path=path, uid=status.st_uid)
    # With the sticky bit, as of /tmp, nobody can replace another user's file.
    if of_folder & stat.S_IWOTH and not of_folder & stat.S_ISVTX:
        yield KeyWarning.REPLACEABLE(path=path, folder=folder)


def _parse(text: str, path: Path) -> Key:
    words = text.split()
    if not words:
        raise KeyFileError(KeyFileProblem.EMPTY(path=path))
    secret = _decode(words[-1])
    if secret is None:
        raise KeyFileError(KeyFileProblem.NO_KEY(path=path, bytes=KEY_BYTES, length=len(words[-1])))
    steps = {(following - byte) % 256 for byte, following in pairwise(secret)}
    if (count := min(len(set(secret)), len(steps))) < DIFFERENT_BYTES:
        raise KeyFileError(KeyFileProblem.WEAK(path=path, count=count))
    return Key(secret)


def _decode(text: str) -> bytes | None:
    try:
        # Without `validate`, characters of no alphabet are skipped, so that a file's name may be a key.
        secret = base64.b64decode(text, altchars=b"-_", validate=True)
    except (binascii.Error, ValueError):  # ValueError: not ASCII
        return None
    return secret if len(secret) == KEY_BYTES else None


def key_files_by_client(session: Session) -> dict[str, tuple[str, ...]]:
    """Return the files of the keys that are valid for each client of a session, by its name, the next key's last.

    A client's session has its own only.
    """
    valid: dict[str, tuple[str | None, ...]] = {}
    if session.role == "client":
        valid[session.name] = (session.key_file,)
    else:
        for client in session.accepted_clients:
            following = client.next_key_file or (session.next_key_file if client.key_file is None else None)
            valid[client.name] = client.key_file or session.key_file, following
    return {name: tuple(file for file in files if file is not None) for name, files in valid.items()}


def key_users(session: Session) -> dict[str, str]:
    users: dict[str, list[str]] = {}
    for client, files in key_files_by_client(session).items():
        for file, user in zip(files, (client, f"{client} (next)"), strict=False):
            users.setdefault(file, []).append(user)
    for operator in session.operators:
        users.setdefault(operator.key_file, []).append(f"operator {operator.name}, who may {operator.may}")
    return {file: ", ".join(each) for file, each in users.items()}


def session_keys(session: Session, base: Path) -> Iterator[tuple[str, Key | KeyFileError]]:
    """Yield each key file that a session needs, its operators' too, with its key or its error.

    Args:
        base: the folder that its key files are relative to.
    """
    of_links = chain.from_iterable(key_files_by_client(session).values()) if session.use_encryption else ()
    for name in dict.fromkeys([*of_links, *(each.key_file for each in session.operators)]):
        try:
            yield name, read_key(key_path(base, name))
        except KeyFileError as error:
            yield name, error


def key_warnings(keys: Mapping[str, tuple[Key, ...]], now: float) -> Iterator[str]:
    """Yield the warnings about the valid keys of each client.

    Args:
        keys: by client's name, the next one last.
        now: s since the epoch.
    """
    # Each once: clients may share a file.
    yield from dict.fromkeys(chain.from_iterable(key.warnings for valid in keys.values() for key in valid))
    for name, valid in keys.items():
        for following in valid[1:]:
            if following == valid[0]:
                yield KeyWarning.SAME_NEXT(name=name, fingerprint=fingerprint(following))
            elif now - following.written > _LONG:
                yield KeyWarning.TWO_FOR_LONG(name=name, since=written(following, now))


def written(key: Key, now: float) -> str:
    """Return when a key's file was written: ``2026-11-18 14:03 (3 days ago)``."""
    passed = now - key.written
    if passed < -60:
        ago = Age.FUTURE()
    elif found := next(((int(passed // size), unit) for size, unit in _SPANS if passed >= size), None):
        ago = Age.AGO(count=found[0], unit=plural(*found))
    else:
        ago = Age.NOW()
    return f"{time.strftime('%Y-%m-%d %H:%M', time.localtime(key.written))} ({ago})"


def unshared_keys(session: Session, base: Path) -> dict[str, tuple[Key, ...]]:
    """Read the valid keys of each client, by its name, the next one last. Without encryption, a client has no keys.

    Args:
        base: the folder that its key files are relative to.

    Raises:
        KeyFileError: a file is missing or holds no key, or two clients have the same key.
    """
    files = key_files_by_client(session)
    if not session.use_encryption:
        return dict.fromkeys(files, ())
    for name, of_client in files.items():
        if not of_client:
            raise KeyFileError(KeyFileProblem.NOT_GIVEN(name=name))
    keys = {name: tuple(read_key(key_path(base, file)) for file in of_client) for name, of_client in files.items()}
    if problem := shared_key_problem(session, keys):
        raise KeyFileError(problem)
    return keys


def shared_key_problem(session: Session, keys: Mapping[str, Collection[Hashable]]) -> str:
    """Return the problem and the remedy if clients share a key without permission, or an empty string.

    Args:
        session: a server's. It may permit shared keys.
        keys: the valid keys of each client, or their fingerprints, by the client's name.
    """
    if session.shared_keys:
        return ""
    owners: dict[Hashable, list[str]] = {}
    for name, valid in keys.items():
        # One client may have the same key twice (`SAME_NEXT`), which shares it with nobody.
        for key in dict.fromkeys(valid):
            owners.setdefault(key, []).append(name)
    shared = [KeyFileProblem.ONE_KEY(names=join_first(names, _NAMED)) for names in owners.values() if len(names) > 1]
    return KeyFileProblem.SHARED(owners="; ".join(shared)) if shared else ""
