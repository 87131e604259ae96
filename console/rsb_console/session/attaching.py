"""Attaching to a bridge of another process: the engine, and what the console knows of its session's file."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.config.session_file import SessionError, SessionFile, load_file
from rsb_bridge.control.remote_engine import RemoteEngine

if TYPE_CHECKING:
    from rsb_bridge.control.connectors import Connector
    from rsb_bridge.model.session import Session


class Attached(NamedTuple):
    """A bridge that is attached to.

    Attributes:
        engine: the engine.
        name: of its session.
        base: the folder that its key files are relative to.
        path: its session file; None: it is in no file, or in one of another machine.
        file: that file as it is now; None: there is none, or it has mistakes.
        saved: the session in it; None likewise.
    """

    engine: RemoteEngine
    name: str
    base: Path
    path: Path | None
    file: SessionFile | None
    saved: Session | None


def attach(where: Path | Connector, *, read_only: bool) -> RemoteEngine:
    """Attach to a bridge by its control socket, or by another way; may take some seconds.

    Raises:
        EngineError: that cannot be done.
    """
    engine = RemoteEngine(where, read_only=read_only)
    engine.start()
    return engine


def attached(engine: RemoteEngine) -> Attached:
    """What the console is to know of an engine that it has attached to."""
    bridge = engine.bridge
    path = Path(bridge.file) if bridge.file is not None and engine.same_machine else None
    file = None
    if path is not None:
        with contextlib.suppress(SessionError):  # it has been changed, or removed
            file = load_file(path)
    return Attached(engine, bridge.name, Path(bridge.base), path, file, None if file is None else file.session)
