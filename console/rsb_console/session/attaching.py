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
    """An attached bridge.

    Attributes:
        name: name of its session.
        base: the folder that its key files are relative to.
        path: its session file, or None without a file on this machine.
        file: that file's present content, or None if it is missing or has mistakes.
        saved: the session in `file`, or None.
    """

    engine: RemoteEngine
    name: str
    base: Path
    path: Path | None
    file: SessionFile | None
    saved: Session | None


def attach(where: Path | Connector, *, read_only: bool) -> RemoteEngine:
    """Attach to a bridge by its control socket or another connection; may take some seconds.

    Raises:
        EngineError: the attachment fails.
    """
    engine = RemoteEngine(where, read_only=read_only)
    engine.start()
    return engine


def attached(engine: RemoteEngine) -> Attached:
    """Describe an attached engine for the console."""
    bridge = engine.bridge
    # A path of another machine may name another file here.
    path = Path(bridge.file) if bridge.file is not None and engine.same_machine else None
    file = None
    if path is not None:
        with contextlib.suppress(SessionError):  # it has been changed, or removed
            file = load_file(path)
    return Attached(engine, bridge.name, Path(bridge.base), path, file, None if file is None else file.session)
