"""The recordings that this machine's bridges have made or fetched, which `V` lists."""

from __future__ import annotations

import asyncio
import os
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from rsb_bridge.config.state_folder import searched_folders
from rsb_console.feature_console import LookOption
from rsb_extras.recording.keep_last import FETCHED, RECORDINGS
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.recording_files import SUFFIXES
from rsb_extras.recording.reading.stored_message import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from textual.app import App

    from rsb_console.feature_console import Console

_LISTED = 20  # of the newest ones. A round figure: they come behind all topics


def recordings_here(environ: Mapping[str, str]) -> list[Path]:
    """Return files and folders of recordings in the folders of bridges, newest first."""
    found: dict[Path, float] = {}
    for folder in (each / RECORDINGS / part for each in searched_folders(environ) for part in ("", FETCHED)):
        with suppress(OSError):  # it is not there, or another user's
            for path in folder.iterdir():
                if path.name.startswith(".") or path.name == FETCHED:
                    continue
                with suppress(OSError):  # it is gone by now
                    if path.suffix in SUFFIXES or path.is_dir():
                        found[path] = path.stat().st_mtime
    return sorted(found, key=lambda path: -found[path])[:_LISTED]


def options() -> Iterator[LookOption]:
    """Yield the recordings, to be looked at."""
    for path in recordings_here(os.environ):
        yield LookOption(f"recording {path.name}", str(path.parent), partial(_show, path))


async def _show(path: Path, console: Console, app: App[Any]) -> None:
    from rsb_extras.playing.review_screen import ReviewScreen  # noqa: PLC0415 -- the list of all is open sooner without

    try:
        recording = await asyncio.to_thread(OpenRecording, path)
    except RecordingError as error:
        console.notify(str(error), title="Not shown", severity="warning", markup=False, timeout=15)
    else:
        app.push_screen(ReviewScreen(recording))
