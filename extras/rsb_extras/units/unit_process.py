"""Runs one command of a unit: a fixed program with fixed arguments, without a shell, within a time."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.feature_api import TEXT_LENGTH, sanitize_text
from rsb_extras.units.unit_records import LINES, UnitState

if TYPE_CHECKING:
    import threading
    from collections.abc import Mapping, Sequence

    from rsb_bridge.feature_api import Clock

OUTPUT = 4096
"""Bytes of the end of an output that are kept."""
_PASSED = (
    "PATH", "HOME", "USER", "LOGNAME", "LANG", "LC_ALL", "TZ", "XDG_RUNTIME_DIR", "DBUS_SESSION_BUS_ADDRESS",
)  # fmt: skip
"""The only variables of the environment that a command gets: what finds programs, the user and systemd's user part."""
_ENDS_WITHIN = 2.0
"""s from SIGTERM to SIGKILL, and from there until a command is left alone that even this does not end."""
_LOOK_EVERY = 0.02  # s between two looks whether it has ended. A round figure
_READ_SIZE = 64 << 10  # a full pipe
_STATES: Mapping[int | None, UnitState] = {
    0: UnitState.RUNNING, 1: UnitState.FAILED, 2: UnitState.FAILED, 3: UnitState.STOPPED,
}  # fmt: skip
"""LSB 5.0, init script actions, `status`; `systemctl is-active` ends with 0 and 3."""


class CommandEnd(NamedTuple):
    """The end of a command.

    Attributes:
        code: exit code, below 0 a signal's number, or None if it is not over or was not begun.
        was_late: whether it was ended, as its time was over.
        output: the last bytes of what it printed.
        problem: why it could not be begun, without its name, or empty.
    """

    code: int | None = None
    was_late: bool = False
    output: bytes = b""
    problem: str = ""

    @property
    def lines(self) -> tuple[str, ...]:
        lines = self.output.decode(errors="replace").expandtabs().splitlines()
        return tuple(sanitize_text(line.rstrip(), TEXT_LENGTH) for line in lines if line.strip())[-LINES:]


def state_of(status: CommandEnd) -> UnitState:
    """Return the state that the end of a unit's `status` tells."""
    # systemd has no exit code of its own for a unit that failed.
    if status.code == 3 and status.output.strip() == b"failed":
        return UnitState.FAILED
    return UnitState.UNKNOWN if status.was_late else _STATES.get(status.code, UnitState.UNKNOWN)


def run_words(words: Sequence[str], seconds: float, clock: Clock, stop: threading.Event) -> CommandEnd:
    """Run a command to its end; call it on a thread.

    Args:
        seconds: time until it gets SIGTERM, with what it has started, except in other sessions (setsid).
        stop: ends it earlier.
    """
    try:
        process = subprocess.Popen(  # noqa: S603 -- the words are the session's own: nothing of a peer is among them
            words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, bufsize=0, cwd="/",
            env={name: os.environ[name] for name in _PASSED if name in os.environ}, start_new_session=True,
        )  # fmt: skip
    except (OSError, ValueError) as error:  # ValueError: a word that no program can get
        return CommandEnd(problem=getattr(error, "strerror", None) or "its words are not valid")
    assert process.stdout is not None
    with process.stdout as pipe:
        os.set_blocking(pipe.fileno(), False)
        output, signals = b"", [signal.SIGKILL, signal.SIGTERM]
        due, was_late = clock.steady() + seconds, False
        # What it leaves in the background may keep the pipe open: only its own end counts.
        while not _has_exited(process):
            output = _read(pipe.fileno(), output)
            if clock.steady() >= due or (stop.is_set() and not was_late):
                was_late, due = True, clock.steady() + _ENDS_WITHIN
                if not signals:
                    return CommandEnd(None, was_late, output)  # it waits for a disk
                _signal_group(process, signals.pop())
            select.select([], [], [], _LOOK_EVERY)
        output = _read(pipe.fileno(), output)
        if was_late:
            _signal_group(process, signal.SIGKILL)  # what has not ended with it
    return CommandEnd(process.wait(), was_late, output)


def _read(pipe: int, output: bytes) -> bytes:
    """Return the end of an output with what the pipe holds now: a full one would hold up the command."""
    with contextlib.suppress(BlockingIOError):
        output = (output + os.read(pipe, _READ_SIZE))[-OUTPUT:]
    return output


def _has_exited(process: subprocess.Popen[bytes]) -> bool:
    """Whether a process has exited. It is not reaped, so that no other group gets its number."""
    return os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _signal_group(process: subprocess.Popen[bytes], number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)
