"""The places of control sockets: nobody else's, never a living process's, and found again by their session."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.console.scripted import SESSION, ScriptedEngine
from tests.support import constants, replaced, surroundings
from tests.support.other_user import OTHER, only_root
from tests.support.wording import pattern

from rsb_bridge.control import bridges, control_sockets
from rsb_bridge.control.bridges import AlreadyRunningError, SessionRuns
from rsb_bridge.control.control_sockets import (
    AttachProblem,
    ControlError,
    ControlSocket,
    SocketProblem,
    StrangerError,
    TakenError,
)
from rsb_bridge.control.remote_engine import RemoteEngine

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.control import Machine

FALLBACK = replaced.FALLBACK_FOLDER.value
LISTENS = """
import socket, sys
listener = socket.socket(socket.AF_UNIX)
listener.bind(sys.argv[1])
listener.listen()
print("ready", flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bridge on a busy machine may answer late."""
    constants.BRIDGES_ASKED_FOR.set(monkeypatch, 60.0)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_only_its_user_may_use_a_socket(machine: Machine) -> None:
    machine.serve()
    assert mode(machine.folder) == 0o700
    assert mode(machine.folder / "robot1.sock") == 0o600


SAYS_HELLO = f"""
import os, socket, sys
sys.path[:0] = {sys.path!r}
from rsb_bridge.control.protocol import VERSION, ConsoleHello, HelloRefused, ConsoleWelcome, encode, frames_to_console
os.setuid(int(sys.argv[2]))
connection = socket.socket(socket.AF_UNIX)
connection.connect(sys.argv[1])
connection.sendall(encode(ConsoleHello(VERSION, "0.1.0")))
for message in frames_to_console().feed(connection.recv(100_000)):
    if isinstance(message, (HelloRefused, ConsoleWelcome)):
        print(type(message).__name__)
"""
SERVES = f"""
import os, sys
sys.path[:0] = {sys.path!r}
from pathlib import Path
from tests.console.scripted import SESSION, ScriptedEngine
from rsb_bridge.control import bridges
os.setuid(int(sys.argv[2]))
server = bridges.serve(ScriptedEngine(), SESSION, file=None, control=Path(sys.argv[1]), on_stop=lambda: None)
os.chmod(sys.argv[1], 0o666)
print("ready", flush=True)
sys.stdin.read()
server.close()
"""
SOMEBODY = 1234


@contextlib.contextmanager
def served_by(uid: int) -> Iterator[Path]:
    """A bridge of a user, in a folder and on a socket that everybody may use."""
    folder = Path("/tmp") / f"rsb-console-test-{os.getpid()}"
    folder.mkdir(mode=0o755)
    os.chown(folder, uid, uid)
    path = folder / "robot1.sock"
    try:
        with subprocess.Popen(
            [sys.executable, "-c", SERVES, str(path), str(uid)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as server:
            assert server.stdout
            assert server.stdin
            assert server.stdout.readline() == b"ready\n"
            yield path
            server.stdin.close()
    finally:
        folder.rmdir()


def answer_to(uid: int, path: Path) -> str:
    """Return the bridge's answer to a user's console."""
    command = [sys.executable, "-c", SAYS_HELLO, str(path), str(uid)]
    return subprocess.run(command, capture_output=True, text=True, timeout=180, check=True).stdout.strip()


@only_root
@pytest.mark.parametrize("of", [0, SOMEBODY])
def test_other_user_is_refused_whatever_files_allow(of: int) -> None:
    """The kernel says who connects; root's bridge serves root, and a user's serves that user and root."""
    with served_by(of) as path:
        assert answer_to(OTHER, path) == "HelloRefused"
        assert answer_to(of, path) == "ConsoleWelcome"
        assert answer_to(0, path) == "ConsoleWelcome"


@only_root
def test_roots_console_does_not_trust_another_users_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """It could have root's console save a session wherever it likes. A service's folder is root's own doing."""
    with served_by(SOMEBODY) as path:
        with pytest.raises(StrangerError):
            bridges.ask(path)
        with pytest.raises(StrangerError):
            RemoteEngine(path).start()
        constants.SERVICES_SOCKETS.set(monkeypatch, path.parent)
        assert bridges.ask(path).info is not None
        os.chown(path.parent, OTHER, OTHER)
        with pytest.raises(StrangerError):
            bridges.ask(path)
        os.chown(path.parent, SOMEBODY, SOMEBODY)


@only_root
def test_root_avoids_folder_of_other_user(machine: Machine) -> None:
    """Anybody can make /tmp/rsb-console-0 before root does."""
    machine.serve()
    assert control_sockets.find_sockets(machine.environ)
    assert control_sockets.hidden_bridges(machine.environ) is None
    os.chown(machine.folder, SOMEBODY, SOMEBODY)
    assert not control_sockets.find_sockets(machine.environ)
    assert control_sockets.hidden_bridges(machine.environ) == SOMEBODY
    os.chown(machine.folder, 0, 0)


@only_root
def test_a_console_does_not_trust_another_users_process(monkeypatch: pytest.MonkeyPatch, machine: Machine) -> None:
    machine.serve()
    replaced.PEER_OF.set(monkeypatch, lambda _: (1, OTHER, OTHER))
    surroundings.set_user(monkeypatch, 1234)
    replaced.FOLDER_PROBLEM.set(monkeypatch, lambda *_, **__: "")
    with pytest.raises(StrangerError):
        bridges.ask(machine.folder / "robot1.sock")


@only_root
def test_a_folder_of_another_users_is_refused(machine: Machine) -> None:
    machine.folder.mkdir()
    os.chown(machine.folder, OTHER, OTHER)
    with pytest.raises(ControlError, match=pattern(SocketProblem.FOLDER_OF_USER)):
        machine.serve()


def test_folder_that_others_may_write_to_is_refused(machine: Machine) -> None:
    machine.folder.mkdir()
    machine.folder.chmod(0o777)
    with pytest.raises(ControlError, match=pattern(SocketProblem.FOLDER_WRITABLE)):
        machine.serve()


def test_a_folder_behind_a_symbolic_link_is_refused(machine: Machine, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    machine.folder.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ControlError):
        machine.serve()


def test_a_dead_processs_socket_is_replaced(machine: Machine) -> None:
    machine.folder.mkdir(mode=0o700)
    path = machine.folder / "robot1.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    assert bridges.running_bridges(machine.environ) == []
    machine.serve()
    assert bridges.ask(path).pid == os.getpid()


def test_a_living_processs_is_never_replaced(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even one that does not answer: it may be busy, or stopped."""
    constants.BRIDGES_ASKED_FOR.set(monkeypatch, 2.0)
    machine.folder.mkdir(mode=0o700)
    path = machine.folder / "robot1.sock"
    command = [sys.executable, "-c", LISTENS, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as living:
        assert living.stdout
        assert living.stdin
        assert living.stdout.readline() == b"ready\n"
        with pytest.raises(TakenError):
            ControlSocket(path, make_folder=True)
        with pytest.raises(
            AlreadyRunningError,
            match=pattern(SessionRuns.NOT_ANSWERING, pid=living.pid, problem=AttachProblem.SILENT()),
        ):
            machine.serve()
        living.stdin.close()
    machine.serve()


def test_file_that_is_no_socket_is_left_alone(machine: Machine, tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    with pytest.raises(ControlError, match=pattern(SocketProblem.NOT_A_SOCKET)):
        machine.serve(control=path)
    assert path.read_text() == "mine"


def test_the_socket_may_be_named(machine: Machine, tmp_path: Path) -> None:
    folder = tmp_path / ("long" * 30)
    folder.mkdir()
    served = machine.serve(control=folder / "my.sock")
    assert bridges.ask(folder / "my.sock").name == "my"
    served.close()
    assert list(folder.iterdir()) == []


def test_closing_does_not_remove_anothers_socket(machine: Machine) -> None:
    served = machine.serve()
    path = machine.folder / "robot1.sock"
    path.unlink()
    machine.serve()
    served.close()
    assert bridges.ask(path).pid == os.getpid()


def test_a_session_is_served_once(machine: Machine, tmp_path: Path) -> None:
    machine.serve(file=tmp_path / "robot1.yaml")
    with pytest.raises(
        AlreadyRunningError,
        match=pattern(SessionRuns.ANSWERING, name="robot1", pid=os.getpid(), path=machine.folder / "robot1.sock"),
    ):
        machine.serve(file=tmp_path / "robot1.yaml")
    with pytest.raises(AlreadyRunningError):
        machine.serve(file=tmp_path / "a-copy.yaml")


def test_both_sides_on_one_machine_have_sockets(machine: Machine) -> None:
    machine.serve()
    machine.serve(ScriptedEngine(msgspec.structs.replace(SESSION, role="server")))
    assert [(each.name, each.info and each.info.role) for each in bridges.running_bridges(machine.environ)] == [
        ("robot1", "client"),
        ("robot1-2", "server"),
    ]


@pytest.mark.parametrize("name", ["a/b", "..", ".hidden", "größe", "x" * 255, "a b\n"])
def test_any_name_of_a_session_makes_a_socket(machine: Machine, name: str) -> None:
    machine.serve(ScriptedEngine(msgspec.structs.replace(SESSION, name=name)))
    (running,) = bridges.running_bridges(machine.environ)
    assert running.info is not None
    assert running.info.name == name
    assert running.path.parent == machine.folder


def test_where_sockets_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replaced.FALLBACK_FOLDER.set(monkeypatch, FALLBACK)  # for the tests it is another
    fallback = Path(f"/tmp/rsb-console-{os.geteuid()}")
    assert control_sockets.serving_folder({}) == fallback
    assert control_sockets.serving_folder({"XDG_RUNTIME_DIR": "/run/user/7"}) == Path("/run/user/7/rsb-console")
    service = {"XDG_RUNTIME_DIR": "/run/user/7", "RUNTIME_DIRECTORY": "/run/rsb-console"}
    assert control_sockets.serving_folder(service) == Path("/run/rsb-console")
    for environ in ({}, service):
        assert {fallback, control_sockets.SERVICES} <= set(control_sockets.searched_folders(environ))
    isolated = {"XDG_RUNTIME_DIR": "/run/user/7", control_sockets.ISOLATED: "1"}
    assert control_sockets.searched_folders(isolated) == [Path("/run/user/7/rsb-console")]
