"""Encryption keys and their files, in the thesis's format: 32 bytes in URL-safe base64, like Fernet's keys."""

from __future__ import annotations

import base64
import binascii
import os
import re
import stat
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rsb_bridge.config.files import kind_of_file, replace_file, typed_path
from rsb_bridge.model.fingerprints import fingerprint_of, format_fingerprint

if TYPE_CHECKING:
    from pathlib import Path

KEY_BYTES = 32
DEFAULT_KEY_FILE = "key.txt"
_MAX_FILE = 4096  # bytes; a key file is 45
# The second form is a key that lost its padding.
_LIKE_A_KEY = re.compile(r"[A-Za-z0-9+/_-]{43}=|(?<![A-Za-z0-9+/_-])[A-Za-z0-9_-]{43}(?![A-Za-z0-9+/_-])")


class KeyFileError(Exception):
    """A key file cannot be read or written. The message names the file and the remedy."""


@dataclass(frozen=True, slots=True)
class Key:
    """A session key. Its repr shows the fingerprint only, so that no log or message gives the key away.

    Attributes:
        secret: 32 bytes, the pre-shared key of the handshake.
        warnings: what an operator should know about its file.
    """

    secret: bytes = field(repr=False)
    warnings: tuple[str, ...] = field(default=(), compare=False)

    def __repr__(self) -> str:
        return f"<Key {fingerprint(self)}>"


def generate() -> bytes:
    """A new key: 44 characters of URL-safe base64, without a line break."""
    return base64.urlsafe_b64encode(os.urandom(KEY_BYTES))


def is_key(text: str) -> bool:
    """Whether a text is an encryption key."""
    return _decode(text) is not None


def is_key_file(text: str) -> bool:
    """Whether a file's text is that of a key file: its last line is a key and nothing else."""
    lines = text.split("\n")
    return is_key(next((line.strip() for line in reversed(lines) if line.strip()), ""))


def conceal(text: str) -> str:
    """A text for a message or a log, with every key in it replaced."""
    return _LIKE_A_KEY.sub("<a key>", text)


def fingerprint(key: Key) -> str:
    """16 hexadecimal digits of the key's SHA-256, in fours: two operators compare them to see whether keys match."""
    return format_fingerprint(fingerprint_of(key.secret))


def write_key(path: Path, *, force: bool = False) -> Key:
    """Generate a key and write it to a file, mode 0600.

    Args:
        path: of the new file.
        force: replace a file that exists. Whoever has only the old key can no longer link.

    Raises:
        KeyFileError: the file exists, or cannot be written.
    """
    text = generate() + b"\n"
    try:
        if force:
            replace_file(path, text)
        else:
            _write_new(path, text)
    except FileExistsError:
        raise KeyFileError(f"{path}: exists already; --force replaces it, and the old key is lost") from None
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be written: {error.strerror}") from None
    return _parse(text.decode(), path)


def copy_key(key: Key, path: Path) -> None:
    """Write a key to one more file, mode 0600. A file that exists is never replaced.

    Raises:
        KeyFileError: the file exists, or cannot be written.
    """
    try:
        _write_new(path, base64.urlsafe_b64encode(key.secret) + b"\n")
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be written: {error.strerror}") from None


def key_path(base: Path, key_file: str) -> Path:
    """The path of a session's key file.

    Args:
        base: the session file's folder.
        key_file: as the session gives it: relative to that folder, absolute, or starting with ``~``.
    """
    return base / typed_path(key_file)


def read_key(path: Path) -> Key:
    """Read a key file. Its last word is the key; whatever comes before it, like the date in the thesis's, is skipped.

    Raises:
        KeyFileError: the file does not exist, cannot be read, or holds no key.
    """
    try:
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            raise KeyFileError(f"{path}: is {kind_of_file(mode)}, not a key file")
        with path.open("rb") as file:
            content = file.read(_MAX_FILE + 1)
    except FileNotFoundError:
        raise KeyFileError(
            f"{path}: no such key file: copy it from the other side, or make one with `rsb-console keygen {path}`"
        ) from None
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be read: {error.strerror}") from None
    if len(content) > _MAX_FILE:
        raise KeyFileError(f"{path}: too large for a key file")
    key = _parse(content.decode("ascii", errors="replace"), path)
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        others = f"{path}: others may read this key (mode {stat.S_IMODE(mode):04o}): run `chmod 600 {path}`"
        return Key(key.secret, (others,))
    return key


def _parse(text: str, path: Path) -> Key:
    words = text.split()
    if not words:
        raise KeyFileError(f"{path}: is empty: make a key with `rsb-console keygen`")
    secret = _decode(words[-1])
    if secret is None:
        raise KeyFileError(
            f"{path}: holds no key: a key is 44 characters of URL-safe base64, {KEY_BYTES} bytes, and the last word of "
            f"the file has {len(words[-1])} characters"
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
