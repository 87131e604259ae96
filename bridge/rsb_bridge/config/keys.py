"""Keys and their files, in the thesis's format: 32 bytes, URL-safe base64, as Fernet's keys are."""

from __future__ import annotations

import base64
import binascii
import hashlib
import os
import re
import stat
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rsb_bridge.config.files import kind_of_file, replace_file, typed_path

if TYPE_CHECKING:
    from pathlib import Path

KEY_BYTES = 32
DEFAULT_KEY_FILE = "key.txt"
_MAX_FILE = 4096  # bytes; a key file is 45
# The second: one whose padding was lost on the way.
_LIKE_A_KEY = re.compile(r"[A-Za-z0-9+/_-]{43}=|(?<![A-Za-z0-9+/_-])[A-Za-z0-9_-]{43}(?![A-Za-z0-9+/_-])")


class KeyFileError(Exception):
    """A key file can't be read or written; the message names it, and what to do."""


@dataclass(frozen=True, slots=True)
class Key:
    """A session key. Its repr shows the fingerprint, so that a key in a log or a message gives nothing away.

    Attributes:
        secret: 32 bytes, the handshake's psk.
        warnings: what an operator should know of the file it came from.
    """

    secret: bytes = field(repr=False)
    warnings: tuple[str, ...] = field(default=(), compare=False)

    def __repr__(self) -> str:
        return f"<Key {fingerprint(self)}>"


def generate() -> bytes:
    """A new key: 44 characters of URL-safe base64, without a line's end."""
    return base64.urlsafe_b64encode(os.urandom(KEY_BYTES))


def is_key(text: str) -> bool:
    """Whether a text is itself a key."""
    return _decode(text) is not None


def is_key_file(text: str) -> bool:
    """Whether a file's text is that of a key file: its last line is a key, and nothing else."""
    lines = text.split("\n")
    return is_key(next((line.strip() for line in reversed(lines) if line.strip()), ""))


def conceal(text: str) -> str:
    """A text for a message or a log, with each key in it left out."""
    return _LIKE_A_KEY.sub("<a key>", text)


def fingerprint(key: Key) -> str:
    """What two people compare to see that both sides have the same key: 16 hex digits of its SHA-256, in fours."""
    digits = hashlib.sha256(key.secret).hexdigest()[:16]
    return " ".join(digits[at : at + 4] for at in range(0, len(digits), 4))


def write_key(path: Path, *, force: bool = False) -> Key:
    """Generate a key into a file of its own, mode 0600.

    Args:
        path: of the new file.
        force: replace a file that is there. Whoever holds only the old key can no longer link.

    Raises:
        KeyFileError: there is a file already, or it could not be written.
    """
    text = generate() + b"\n"
    try:
        if force:
            replace_file(path, text)
        else:
            _write_new(path, text)
    except FileExistsError:
        raise KeyFileError(f"{path}: exists already, and a key once lost is lost; --force replaces it") from None
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be written: {error.strerror}") from None
    return _parse(text.decode(), path)


def copy_key(key: Key, path: Path) -> None:
    """Write a key that there is already into a file of its own too, mode 0600; never over a file.

    Raises:
        KeyFileError: there is a file already, or it could not be written.
    """
    try:
        _write_new(path, base64.urlsafe_b64encode(key.secret) + b"\n")
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be written: {error.strerror}") from None


def key_path(base: Path, key_file: str) -> Path:
    """Where a session's key file is.

    Args:
        base: the session file's folder.
        key_file: as the session names it: relative to that, absolute, or from ``~``.
    """
    return base / typed_path(key_file)


def read_key(path: Path) -> Key:
    """Read a key file: its last word is the key; what stands before, like the date in the thesis's key.txt, is skipped.

    Raises:
        KeyFileError: it is not there, cannot be read, or holds no key.
    """
    try:
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            raise KeyFileError(f"{path}: is {kind_of_file(mode)}, not a key file")
        with path.open("rb") as file:
            content = file.read(_MAX_FILE + 1)
    except FileNotFoundError:
        raise KeyFileError(
            f"{path}: no such key file; copy it from the other side, or make one with `rsb-console keygen {path}`"
        ) from None
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be read: {error.strerror}") from None
    if len(content) > _MAX_FILE:
        raise KeyFileError(f"{path}: too large for a key file")
    key = _parse(content.decode("ascii", errors="replace"), path)
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        others = f"{path}: others may read this key (mode {stat.S_IMODE(mode):04o}); `chmod 600 {path}` stops that"
        return Key(key.secret, (others,))
    return key


def _parse(text: str, path: Path) -> Key:
    words = text.split()
    if not words:
        raise KeyFileError(f"{path}: is empty; make a key with `rsb-console keygen`")
    secret = _decode(words[-1])
    if secret is None:
        raise KeyFileError(
            f"{path}: holds no key: that is {KEY_BYTES} bytes as 44 characters of URL-safe base64, and the last word "
            f"in there has {len(words[-1])} characters"
        )
    return Key(secret)


def _decode(text: str) -> bytes | None:
    try:
        secret = base64.b64decode(text, altchars=b"-_", validate=True)
    except (binascii.Error, ValueError):  # ValueError: not ASCII
        return None
    return secret if len(secret) == KEY_BYTES else None


def _write_new(path: Path, content: bytes) -> None:
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        path.unlink()
        raise
