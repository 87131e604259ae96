"""The folder of recordings that were fetched: bounded in bytes, so that nobody has to tidy it."""

from __future__ import annotations

import os
import stat
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.config.files import UNFINISHED
from rsb_bridge.feature_api import Wording
from rsb_extras.courier.fetch_spool import SPOOL
from rsb_extras.courier.live_parts import LIVE

if TYPE_CHECKING:
    from collections.abc import Iterator

_OWN_MODE = 0o600
"""Of what a bridge writes there. A file with another mode is an operator's to remove."""


class FetchedText(Wording):
    FULL = (
        "{folder} is full: what is being fetched, and what you have kept there, has {size:.3g} of {most:g} GB; move or "
        "remove some, or raise recordings.fetched"
    )


class FolderFullError(Exception):
    """There is no room, unless an operator makes some; the text says so."""


def make_room(folder: Path, most: float) -> list[Path]:
    """Remove the oldest recordings that were fetched, until the folder has so many GB at most; return them.

    What is being fetched counts, and stays. So does a file whose mode is not the bridge's: an operator keeps it. What
    came live for it stays, and does not count: the ring has its own bound, and with a larger one a fetch waited for
    ever.

    Raises:
        FolderFullError: what stays has more. Nothing is removed.
        OSError: one cannot be removed.
    """
    sizes = dict(_files(folder))
    names = Counter(map(_inode, sizes.values()))  # a fetch may link what another one or the folder has
    total = sum({_inode(status): status.st_size for path, status in sizes.items() if not _came_live(path)}.values())
    removable = sorted(
        (
            path
            for path, status in sizes.items()
            if path.parent == folder and _is_own(path, status) and names[_inode(status)] == 1
        ),
        key=lambda path: (sizes[path].st_mtime_ns, path.name),
    )
    stays = total - sum(sizes[path].st_size for path in removable)
    if stays > most * 1e9:
        raise FolderFullError(FetchedText.FULL(folder=folder, size=stays / 1e9, most=most))
    removed = []
    for path in removable:
        if total <= most * 1e9:
            break
        path.unlink(missing_ok=True)
        total -= sizes[path].st_size
        removed.append(path)
    return removed


def _inode(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino


def _came_live(path: Path) -> bool:
    return path.parent.name in (LIVE, f"{LIVE}{UNFINISHED}") and path.parents[1].name.endswith(SPOOL)


def _is_own(path: Path, status: os.stat_result) -> bool:
    return (
        path.suffix == ".mcap"
        and not path.name.startswith(".")
        and stat.S_IMODE(status.st_mode) == _OWN_MODE
        and status.st_uid == os.geteuid()
    )


def _files(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    for place, _, names in os.walk(folder):
        for name in names:
            path = Path(place, name)
            try:
                status = path.lstat()
            except FileNotFoundError:  # a fetch has ended meanwhile
                continue
            if stat.S_ISREG(status.st_mode):
                yield path, status
