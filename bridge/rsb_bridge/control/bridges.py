"""The bridges that run on this machine: finding them, and joining them with one's own."""

from __future__ import annotations

import itertools
import os
import signal
import time
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge import __version__
from rsb_bridge.config.files import file_stem
from rsb_bridge.control import control_sockets, protocol
from rsb_bridge.control.control_server import ControlServer
from rsb_bridge.control.control_sockets import AttachProblem, ControlError, ControlSocket, NotServedError, TakenError
from rsb_bridge.control.protocol import BridgeInfo, ConsoleWelcome, ControlProtocolError, HelloRefused
from rsb_bridge.installed_features import features_with, guarded
from rsb_bridge.model.text import encodable, one_line
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rsb_bridge.api import EngineApi
    from rsb_bridge.control.protocol import ToConsole
    from rsb_bridge.model.session import Session

_ASKED_FOR = 2.0
"""s. A round figure: each bridge that hangs delays a command so much, as they are asked one after the other."""
_READ_SIZE = 64 << 10


@dataclass(frozen=True, slots=True)
class RunningBridge:
    """A bridge that runs on this machine.

    Attributes:
        path: of its control socket.
        uid: the user as whom it runs, as the kernel says, like `pid`.
        info: its description, or None if it does not answer, or not to this version.
        problem: the reason that `info` is None, or an empty string.
    """

    path: Path
    pid: int
    uid: int
    info: BridgeInfo | None
    problem: str = ""

    @property
    def name(self) -> str:
        """The operator's name for it: the socket's name, which no other bridge of the same user has."""
        return self.path.name.removesuffix(control_sockets.SUFFIX)

    @property
    def trusted(self) -> bool:
        """Whether it runs as this user or root: what it says is true, as far as this user can tell."""
        return control_sockets.may_control(self.uid)

    @property
    def file(self) -> Path | None:
        """The path of its session file, or None if it has none, or another user's process names it."""
        return Path(self.info.file) if self.trusted and self.info is not None and self.info.file else None

    def runs(self, path: Path) -> bool:
        """Whether it says that it runs a session file."""
        if self.file is not None:
            return self.file.resolve() == path.resolve()
        # No path of another user's is looked at, but compared.
        return self.info is not None and self.info.file in (str(path.absolute()), os.path.realpath(path))

    @property
    def attach_command(self) -> str:
        """The command line that attaches to it."""
        if self.path.parent in control_sockets.searched_folders(os.environ):
            return f"rsb-console attach {self.name}"
        return f"rsb-console attach --control {self.path}"

    def __str__(self) -> str:
        if self.info is None:
            return one_line(f"{self.name}: pid {self.pid}, {self.path} ({self.problem})")
        file = f", {self.info.file}" if self.info.file else ""
        return one_line(f"{self.name}: {self.info.role}, {self.info.address}, pid {self.pid}{file}")


class SessionRuns(Wording):
    """Refusals of a session that runs on this machine already."""

    ANSWERING = "{name} already runs here: pid {pid}, socket {path}"
    NOT_ANSWERING = "{name} already runs here: pid {pid}, socket {path} ({problem})"


class AlreadyRunningError(ControlError):
    """A session that runs on this machine already."""

    def __init__(self, bridge: RunningBridge) -> None:
        text = SessionRuns.NOT_ANSWERING if bridge.problem else SessionRuns.ANSWERING
        super().__init__(text(name=bridge.name, pid=bridge.pid, path=bridge.path, problem=bridge.problem))
        self.bridge = bridge


def ask(path: Path) -> RunningBridge:
    """Ask who serves a control socket.

    Raises:
        ControlError: nobody does, or it may not be used.
    """
    with control_sockets.connect(path, _ASKED_FOR) as connection:
        pid, uid, _ = control_sockets.peer_of(connection)
        deadline = time.monotonic() + _ASKED_FOR
        try:
            connection.sendall(protocol.encode(protocol.hello(read_only=True)))
            frames = protocol.frames_to_console()
            while data := connection.recv(_READ_SIZE):
                for message in frames.feed(data):
                    if not control_sockets.may_control(uid):
                        message = _cleaned(message)  # noqa: PLW2901 -- the same one
                    if isinstance(message, ConsoleWelcome):
                        return RunningBridge(path, pid, uid, message.bridge)
                    if isinstance(message, HelloRefused):
                        return RunningBridge(path, pid, uid, None, message.reason)
                # One that never comes to an end must not hold up a command.
                if (left := deadline - time.monotonic()) <= 0:
                    return RunningBridge(path, pid, uid, None, AttachProblem.SILENT())
                connection.settimeout(left)
        except (OSError, ControlProtocolError) as error:
            problem = AttachProblem.SILENT() if isinstance(error, TimeoutError) else str(error)
            return RunningBridge(path, pid, uid, None, problem)
    return RunningBridge(path, pid, uid, None, "it closed the connection")


def _cleaned(message: ToConsole) -> ToConsole:
    """Clean a message of another user's bridge."""
    from rsb_bridge.control.states import clean  # noqa: PLC0415 -- only root meets such a bridge

    return clean(message)


def running_bridges(environ: Mapping[str, str] = os.environ) -> list[RunningBridge]:
    """Return all bridges that this user can attach to, or that at least exist."""
    found = []
    for path in control_sockets.find_sockets(environ):
        try:
            found.append(ask(path))
        except ControlError:  # the socket of a dead process, or another user's
            continue
    return found


def serve(
    engine: EngineApi,
    session: Session,
    *,
    file: Path | None,
    control: Path | None,
    on_stop: Callable[[], None] | None = None,
    environ: Mapping[str, str] = os.environ,
) -> ControlServer:
    """Serve an engine that is not started yet. From now on this machine refuses to start the same session again.

    Args:
        control: the path of the socket, or None for one in the user's folder, named after the session.
        on_stop: ends the process, on another thread, or None to send SIGTERM.
        environ: names the user's folder.

    Raises:
        AlreadyRunningError: another process runs the session.
        ControlError: there can be no socket.
    """
    info = BridgeInfo(
        name=session.name,
        role=session.role,
        address=engine.snapshot().address,
        pid=os.getpid(),
        started=time.time(),
        instance=uuid.uuid4().hex,
        program=__version__,
        # A path may have bytes that are no UTF-8, which a message cannot hold.
        file=None if file is None else encodable(str(file.absolute())),
        base=encodable(str((file.parent if file is not None else Path()).absolute())),
    )
    listener = _claim(info, environ) if control is None else _claim_path(control)
    server = ControlServer(engine, listener, info, on_stop or _terminate)
    server.start()
    for feature in features_with("serve"):
        with guarded(feature, "serve"):
            feature.serve(server)
    return server


def _terminate() -> None:
    os.kill(os.getpid(), signal.SIGTERM)


def _claim(info: BridgeInfo, environ: Mapping[str, str]) -> ControlSocket:
    """Listen on the first free socket of the session's name, if no other process runs the session."""
    # Also in other folders than this process's own: systemd may run the session as a service.
    for bridge in running_bridges(environ):
        if bridge.info is not None and _is_same(bridge.info, info):
            raise AlreadyRunningError(bridge)
    folder = control_sockets.serving_folder(environ)
    for number in itertools.count(1):
        path = folder / f"{file_stem(info.name, number)}{control_sockets.SUFFIX}"
        try:
            return ControlSocket(path, make_folder=True)
        except TakenError:
            holder = _holder(path)
            # One that does not answer may be of this session.
            if holder is not None and (holder.info is None or _is_same(holder.info, info)):
                raise AlreadyRunningError(holder) from None
    raise AssertionError("endless")


def _claim_path(path: Path) -> ControlSocket:
    try:
        return ControlSocket(path, make_folder=False)
    except TakenError:
        bridge = _holder(path)
        if bridge is None:
            return ControlSocket(path, make_folder=False)
        raise AlreadyRunningError(bridge) from None


def _holder(path: Path) -> RunningBridge | None:
    """Return the bridge that serves a taken socket, or None if it has ended meanwhile."""
    try:
        return ask(path)
    except NotServedError:
        return None


def _is_same(one: BridgeInfo, other: BridgeInfo) -> bool:
    """Whether two bridges are of one session: from the same file, or with the same peer under the same name."""
    if (one.name, one.role) != (other.name, other.role):
        return False
    return one.address == other.address or (one.file is not None and one.file == other.file)
