"""The recordings that this machine's bridges have made or fetched, which `V` lists."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from rsb_bridge.config.state_folder import searched_folders
from rsb_extras.recording.keep_last import RECORDINGS

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_LISTED = 20  # of the newest ones. A round figure: they come behind all topics


def recordings_here(environ: Mapping[str, str]) -> list[Path]:
    """Return files and folders of recordings in the folders of bridges, newest first."""
    found: dict[Path, float] = {}
    for folder in searched_folders(environ):
        with suppress(OSError):  # it is not there, or another user's
            for path in (folder / RECORDINGS).iterdir():
                if not path.name.startswith(".") and (path.suffix in (".mcap", ".db3") or path.is_dir()):
                    found[path] = path.stat().st_mtime
    return sorted(found, key=lambda path: -found[path])[:_LISTED]
