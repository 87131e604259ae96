"""A user's control sockets: engines that are served there, and consoles that attach to them."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, TypeVar

from tests.console.scripted import ScriptedEngine

from rsb_bridge.control import bridges
from rsb_bridge.control.remote_engine import RemoteEngine

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from rsb_bridge.control.control_server import ControlServer

E = TypeVar("E")


class Machine:
    """One user's folder of control sockets.

    Attributes:
        environ: says where it is.
        stopped: how often a console has asked for the end of a process.
        served: all servers so far.
        engines: what they serve.
    """

    def __init__(self, folder: Path) -> None:
        self.environ = {"XDG_RUNTIME_DIR": str(folder), "RSB_CONSOLE_ISOLATED": "1"}
        self.folder = folder / "rsb-console"
        self.stopped = 0
        self.served: list[ControlServer] = []
        self.engines: list[Any] = []
        self._resources = contextlib.ExitStack()

    def serve(self, engine: Any = None, **changes: Any) -> ControlServer:
        """Serve an engine; a scripted one if none is given."""
        engine = ScriptedEngine() if engine is None else engine
        given = {"file": None, "control": None, "on_stop": self._stop, "environ": self.environ}
        server = bridges.serve(engine, engine.session, **(given | changes))
        self.served.append(server)
        self.engines.append(engine)
        self._resources.callback(server.close)
        return server

    def have(self, engine: E, **changes: Any) -> E:
        """Serve an engine; return it."""
        self.serve(engine, **changes)
        return engine

    def attach(self, name: str = "robot1", *, read_only: bool = False) -> RemoteEngine:
        remote = RemoteEngine(self.folder / f"{name}.sock", read_only=read_only)
        remote.start()
        self.in_the_end(remote.stop)
        return remote

    def attach_to(self, engine: Any = None, *, read_only: bool = False) -> RemoteEngine:
        self.serve(engine)
        return self.attach(read_only=read_only)

    def in_the_end(self, work: Callable[[], object]) -> None:
        """Register something to do before everything begun until now is ended."""
        self._resources.callback(work)

    def _stop(self) -> None:
        self.stopped += 1

    def close(self) -> None:
        """Detach, and stop serving."""
        self._resources.close()
