"""Writes initramfs archives: "newc" cpio, as the kernel's driver-api/early-userspace/buffer-format.rst has it.

The kernel unpacks archives that follow each other in one file over each other, so layers are simply concatenated.
"""

from __future__ import annotations

import stat
from pathlib import PurePosixPath
from typing import BinaryIO

_BLOCK = 512


class Archive:
    """One archive, open for writing; everything in it belongs to root.

    Attributes:
        file: a binary file, at the archive's start.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self._count = 0
        self._folders: set[str] = set()

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *exception: object) -> None:
        self._entry("TRAILER!!!", 0, b"")
        self.file.write(bytes(-self.file.tell() % _BLOCK))

    def add(self, path: PurePosixPath, content: bytes, mode: int = 0o644) -> None:
        """Add a file, and the folders above it."""
        self._add_parents(path)
        self._entry(str(path), stat.S_IFREG | mode, content)

    def add_symlink(self, path: PurePosixPath, target: str) -> None:
        """Add a symbolic link, and the folders above it."""
        self._add_parents(path)
        self._entry(str(path), stat.S_IFLNK | 0o777, target.encode())

    def _add_parents(self, path: PurePosixPath) -> None:
        for folder in reversed(path.parents[:-1]):
            if str(folder) not in self._folders:
                self._folders.add(str(folder))
                self._entry(str(folder), stat.S_IFDIR | 0o755, b"")

    def _entry(self, name: str, mode: int, content: bytes) -> None:
        self._count += 1
        encoded = name.encode() + b"\0"
        links = 2 if stat.S_ISDIR(mode) else 1
        # inode, mode, uid, gid, links, mtime, size, device (major, minor), special device (same), name length, checksum
        fields = (self._count, mode, 0, 0, links, 0, len(content), 0, 0, 0, 0, len(encoded), 0)
        self._aligned(b"070701" + b"".join(b"%08X" % field for field in fields) + encoded)
        self._aligned(content)

    def _aligned(self, data: bytes) -> None:
        self.file.write(data)
        self.file.write(bytes(-self.file.tell() % 4))
