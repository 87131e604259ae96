"""Processes that an interpreter which has imported everything forks: to start one by itself takes 0.5 s of CPU more.

Each process of pytest has one such interpreter, from its first `Forked` on. A test that is about how a program starts
starts it by itself.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import gc
import importlib
import json
import os
import resource
import runpy
import select
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from tests.support.handles import Handle

_ROOT = Path(__file__).parents[2]
_FOR_ALL = ("rsb_bridge.ros.participant", "std_msgs.msg", "geometry_msgs.msg", "rclpy.node", "rclpy.executors")
_RSB_CONSOLE = ("rsb_console.cli", "rsb_console.command.headless", "rsb_console.command.route_commands")
_FOR_MODULE = {
    "rsb_console": _RSB_CONSOLE,
    "tests.system.torture.program": _RSB_CONSOLE,
    "tests.support.calls": ("nav_msgs.srv",),
    "tests.support.fibonacci": ("pytest", "rclpy.action", "test_msgs.action"),
}
_FOR_TERMINAL = ("rsb_console.app", "rsb_console.command.console_command")
_MOST = 1 << 20
"""Bytes of a request."""


class Forked:
    """``python -m MODULE ARGUMENTS`` in a process of its own, with those parts of `subprocess.Popen` that tests use.

    Args:
        stdin, stdout, stderr: a descriptor, a file, `subprocess.DEVNULL`, `subprocess.PIPE` for text, or None for this
            process's own.
        environ: of the process, in addition to this one's.
        terminal: its standard input is to be its terminal.
        descriptors: the soft and hard limits of its descriptors, or None for this process's own.
    """

    def __init__(
        self,
        module: str,
        *arguments: str,
        stdin: int | IO[Any] | None = subprocess.DEVNULL,
        stdout: int | IO[Any] | None = None,
        stderr: int | IO[Any] | None = None,
        environ: Mapping[str, str] | None = None,
        terminal: bool = False,
        descriptors: tuple[int, int] | None = None,
    ) -> None:
        request = {
            "module": module,
            "arguments": [*map(str, arguments)],
            "folder": str(Path.cwd()),
            "environ": os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"} | dict(environ or {}),
            "terminal": terminal,
            "descriptors": descriptors,
        }
        self.returncode: int | None = None
        with contextlib.ExitStack() as theirs:
            self.stderr: Any = None
            given_in, self.stdin = _ends(stdin, 0, theirs)
            given_out, self.stdout = _ends(stdout, 1, theirs)
            given_err = given_out
            if stderr != subprocess.STDOUT:
                given_err, self.stderr = _ends(stderr, 2, theirs)
            self._end, told = os.pipe()
            theirs.callback(os.close, told)
            self.pid = _forker().fork(request, (given_in, given_out, given_err, told))
        self._handle = Handle(self.pid)

    def poll(self) -> int | None:
        """Return its exit code, or None while it runs."""
        return self._code(0)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end.

        Raises:
            subprocess.TimeoutExpired: it still runs.
        """
        if (code := self._code(timeout)) is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        return code

    def _code(self, timeout: float | None) -> int | None:
        if self.returncode is None and select.select([self._end], [], [], timeout)[0]:
            self.returncode = int(os.read(self._end, 16) or -signal.SIGKILL)
            os.close(self._end)
            self._handle.kill()  # which closes it
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""
        with contextlib.suppress(ProcessLookupError):
            self._handle.signal(signal.Signals(number))

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """End its input, read its output, and wait for its end."""
        if self.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self.stdin.close()
        read = [stream.read() if stream is not None else "" for stream in (self.stdout, self.stderr)]
        self.wait(timeout)
        self._close_pipes()
        return read[0], read[1]

    def __enter__(self) -> Forked:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close its pipes, and wait for its end."""
        self._close_pipes()
        self.wait()

    def _close_pipes(self) -> None:
        for stream in (self.stdin, self.stdout, self.stderr):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()


def _ends(asked: int | IO[Any] | None, own: int, theirs: contextlib.ExitStack) -> tuple[int, Any]:
    """Return the descriptor that the process gets, and this process's end of a pipe, or None."""
    if asked == subprocess.PIPE:
        read, write = os.pipe()
        given, kept = (read, write) if own == 0 else (write, read)
        theirs.callback(os.close, given)
        return given, os.fdopen(kept, "w" if own == 0 else "r", encoding="utf-8")
    if asked == subprocess.DEVNULL:
        given = os.open(os.devnull, os.O_RDWR)
        theirs.callback(os.close, given)
        return given, None
    if asked is None:
        return own, None
    return asked if isinstance(asked, int) else asked.fileno(), None


class _Forker:
    """The interpreter. It ends with this process, and ends what still runs then."""

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(theirs.fileno())],
                cwd=_ROOT,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
            )
        self._lock = threading.Lock()

    def fork(self, request: Mapping[str, Any], descriptors: tuple[int, ...]) -> int:
        """Return the id of a new process."""
        with self._lock:
            socket.send_fds(self._socket, [json.dumps(request).encode()], descriptors)
            answer = self._socket.recv(_MOST)
        assert answer, "it has ended"
        return int(answer)

    def close(self) -> None:
        self._socket.close()
        self._process.wait()


_forkers: list[_Forker] = []


def _forker() -> _Forker:
    if not _forkers:
        _forkers.append(_Forker())
        atexit.register(end)
    return _forkers[0]


def end() -> None:
    """End the interpreter, and with it all that it has forked."""
    while _forkers:
        _forkers.pop().close()


# --- the interpreter


class _Children:
    """The processes that it has forked."""

    def __init__(self, orders: socket.socket) -> None:
        self._orders = orders
        self._poll = select.poll()
        self._poll.register(orders, select.POLLIN)
        self._told: dict[int, tuple[int, int]] = {}

    def serve(self) -> dict[str, Any] | None:
        """Fork as told; return what to do in a child, or None at the end."""
        while True:
            for descriptor, _ in self._poll.poll():
                if descriptor in self._told:
                    self._reap(descriptor)
                    continue
                data, given, _, _ = socket.recv_fds(self._orders, _MOST, 4)
                if not data:
                    self._end()
                    return None
                request = json.loads(data)
                _load(request)
                if not (pid := os.fork()):
                    self._leave(given)
                    return dict(request)
                self._watch(pid, given)
                self._orders.send(str(pid).encode())

    def _watch(self, pid: int, given: list[int]) -> None:
        *streams, told = given
        for stream in {*streams}:
            os.close(stream)
        handle = os.pidfd_open(pid)
        self._told[handle] = pid, told
        self._poll.register(handle, select.POLLIN)

    def _reap(self, handle: int) -> None:
        pid, told = self._told.pop(handle)
        self._poll.unregister(handle)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        with contextlib.suppress(BrokenPipeError):
            os.write(told, str(code).encode())
        os.close(told)
        os.close(handle)

    def _end(self) -> None:
        for handle in [*self._told]:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(handle, signal.SIGKILL)
            self._reap(handle)

    def _leave(self, given: list[int]) -> None:
        """Have a child keep nothing but its own streams."""
        for number, stream in enumerate(given[:3]):
            os.dup2(stream, number)
        for each in given:
            os.close(each)
        for handle, (_, told) in self._told.items():
            os.close(handle)
            os.close(told)


def _load(request: Mapping[str, Any]) -> None:
    """Import what a process needs."""
    names = _FOR_ALL + _FOR_MODULE.get(request["module"], ()) + _FOR_TERMINAL * request["terminal"]
    if new := [name for name in names if name not in sys.modules]:
        for name in new:
            importlib.import_module(name)
        gc.freeze()


def _become(request: Mapping[str, Any]) -> None:
    """Run a module in this process, which has just been forked."""
    if request["terminal"]:
        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    if request["descriptors"]:
        resource.setrlimit(resource.RLIMIT_NOFILE, tuple(request["descriptors"]))
    os.chdir(request["folder"])
    sys.path.insert(0, request["folder"])
    os.environ.clear()
    os.environ.update(request["environ"])
    time.tzset()
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = open(  # noqa: SIM115 -- as long as the process
            number,
            "w" if number else "r",
            encoding="utf-8",
            errors="backslashreplace" if name == "stderr" else "surrogateescape",
            buffering=1 if name == "stderr" or os.isatty(number) else -1,
            closefd=False,
        )
        vars(sys).update({name: stream, f"__{name}__": stream})
    sys.argv = [request["module"], *request["arguments"]]
    runpy.run_module(request["module"], run_name="__main__", alter_sys=True)


class _Exit:
    """The end of a child, after all that Python does at an exit.

    The rest is left out: a library of ROS ends a thread there that only the interpreter had, and that was a crash.
    """

    def __init__(self) -> None:
        self._code = 0
        atexit.register(self._exit)  # before all others, so it is called last

    @contextlib.contextmanager
    def __call__(self) -> Iterator[None]:
        try:
            yield
        except SystemExit as error:
            self._code = error.code if isinstance(error.code, int) else int(error.code is not None)
            raise
        except BaseException:
            self._code = 1
            raise

    def _exit(self) -> None:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(self._code)


def _main() -> None:
    at_exit = _Exit()
    with socket.socket(fileno=int(sys.argv[1])) as orders:
        request = _Children(orders).serve()
    if request is not None:
        with at_exit():
            _become(request)


if __name__ == "__main__":
    _main()
