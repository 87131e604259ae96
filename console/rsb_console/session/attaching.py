"""Attaching to a bridge of another process, and the file of its session."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.control.remote_engine import RemoteEngine

if TYPE_CHECKING:
    from rsb_bridge.control.remote_engine import Connector


def attach(where: Path | Connector, *, read_only: bool) -> RemoteEngine:
    """Attach to a bridge by its control socket or another connection; may take some seconds.

    Raises:
        EngineError: the attachment fails.
    """
    engine = RemoteEngine(where, read_only=read_only)
    engine.start()
    return engine


def file_here(engine: RemoteEngine) -> Path | None:
    """Return the path of an attached bridge's session file, or None without a file on this machine."""
    # A path of another machine may name another file here.
    return Path(engine.bridge.file) if engine.bridge.file is not None and engine.same_machine else None
