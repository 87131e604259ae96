"""Runs the session's `on_fault` command when a fault begins, changes or is over. The engine never waits for it."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import threading
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import (
    TEXT_LENGTH,
    EnginePart,
    Level,
    LinkSnapshot,
    program_path,
    program_problem,
    sanitize_text,
)
from rsb_bridge.model.faults import ChangeKind, FaultChange, FaultWatch
from rsb_bridge.model.limits import REASON_LENGTH
from rsb_bridge.model.snapshot import PatternSnapshot
from rsb_bridge.model.text import encodable
from rsb_extras.exporters import ON_FAULT
from rsb_extras.exporters.exporter_codes import ExporterCode
from rsb_extras.exporters.fault_command import command_words

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from rsb_bridge.feature_api import Context, Snapshot

VERSION = 1
"""Grows when a field is removed or changes its meaning; a new field does not change it."""
REMOVED = "removed"
"""State of a link, a route or a pattern that was removed."""


def fault_report(
    changes: Sequence[FaultChange], *, time: float, bridge: str, role: str, ongoing: int, merged: int
) -> tuple[bytes, int]:
    """Encode changes as one line of ASCII: the first with its fields, and a list of the others.

    Texts are cut and cleaned of control characters, since some come from the other side.

    Args:
        changes: to report, the most important first.
        time: s since the epoch.
        ongoing: number of faults that are reported and not over, these included.
        merged: number of earlier changes for which no command was run.

    Returns:
        The line, and how many of the changes are in it: as many as a pipe holds.
    """
    first, *others = changes
    content: dict[str, object] = {"version": VERSION, "time": round(time, 3), "bridge": _text(bridge), "role": role}
    content |= _about(first, time, role) | {"ongoing": ongoing, "merged": merged}
    room = _LINE - len(json.dumps(content))
    told: list[dict[str, object]] = []
    for each in others:
        about = _about(each, time, role)
        room -= len(json.dumps(about)) + len(", ")
        if room < 0:
            break
        told.append(about)
    return json.dumps(content | {"others": told}).encode("ascii") + b"\n", 1 + len(told)


def _about(change: FaultChange, time: float, role: str) -> dict[str, object]:
    """Return the fields of one change."""
    subject = change.subject
    content: dict[str, object] = {"event": change.kind}
    if isinstance(subject, LinkSnapshot):
        content |= {"what": "link", "kind": "link", "name": _text(subject.name), "link": _text(subject.name)}
        text, from_peer, since = subject.reason or subject.warning, False, subject.fault_since
    elif isinstance(subject, PatternSnapshot):
        # An entry's direction is the client's, on both sides.
        sends = (subject.spec.direction == "transmit") == (role == "client")
        content |= {"what": "pattern", "kind": subject.spec.kind, "name": _text(subject.spec.topic)}
        content |= {"link": _text(subject.link), "outgoing": sends}
        text, from_peer, since = subject.reason, False, change.seen
    else:
        content |= {"what": "route", "kind": subject.spec.kind, "name": _text(subject.topic)}
        content |= {"link": _text(subject.link), "outgoing": subject.outgoing}
        text, from_peer, since = subject.reason, subject.from_peer, subject.since
    state, cause = (REMOVED, "") if change.removed else (str(subject.state), subject.cause)
    return content | {
        "state": _text(state),
        "cause": _text(cause),
        "text": "" if change.removed else _text(text, REASON_LENGTH),
        "since": round(time if change.removed else since, 3),
        "from_peer": from_peer,
        "previous_state": _text(change.before[0]),
        "previous_cause": _text(change.before[1]),
    }


def _text(text: str, limit: int = TEXT_LENGTH) -> str:
    return sanitize_text(encodable(text), limit)


RUNS_FOR = 10.0
"""s after which a command is killed, with everything that it has started. A round figure: further changes wait for
the end of the command."""
WAITING = 256
"""Changes of different links, routes and patterns that wait for their command; later ones are counted as merged. A
round figure, which bounds memory."""
_LINE = 60_000
"""Bytes of a report: a pipe holds 64 KiB, so that a command that does not read holds up nothing."""
EVERY = 1.0
"""s between two starts of the command, at least. Changes that come together share one. A round figure."""
STARTS, STARTS_WITHIN = 10, 60.0
"""The most starts of the command, and the s in which they are counted."""
FOR_LINKS = 3
"""Starts of these that are kept for changes of links. Otherwise, 30 silent topics use up all of them, and nobody is
told of a link that is down."""
OUTPUT = 1000
"""Characters of a command's output that are logged; the rest is read and dropped. A round figure."""
_ENDS_WITHIN = 1.0
"""s from SIGTERM to SIGKILL for a command that takes too long, and s that `join` waits for the thread."""
_ENDS_WITHIN_AT_STOP = 0.2
"""s from SIGTERM to SIGKILL while the bridge ends: `join` waits 1 s for all of it."""
_LOOK_EVERY = 0.05
"""s between two checks of a running command. A round figure."""
_TOLD_EVERY = 60.0
"""s between two events about a problem, at least. A round figure."""
_READ_SIZE = 64 << 10
"""Bytes that a pipe holds: one read empties it."""
_OF_THE_BRIDGE = ("LD_", "PYTHON", "NOTIFY_SOCKET", "WATCHDOG_", "LISTEN_")
"""Prefixes of the environment variables that are meant for the bridge's process: for its loader, Python and
supervisor."""


class FaultHook(EnginePart):
    """Runs the command of the present session. It belongs to the I/O thread.

    Args:
        context: the session, the clock and the event log.
        folder: gives the folder of the session file.
    """

    def __init__(self, context: Context, folder: Callable[[], Path]) -> None:
        super().__init__()
        self._context = context
        self._folder = folder
        self._runner: _Runner | None = None
        self.by_key = (((ON_FAULT.name,), self.open),)

    def open(self) -> None:
        """Start with the session's present command. It also runs for faults that have begun already."""
        before, self._runner = self._runner, None
        if before is not None:
            before.end()
        if (command := ON_FAULT.of(self._context.session)) is not None:
            self._runner = _Runner(self._context, command_words(command), self._folder())
            self._runner.thread.start()

    def tick(self, snapshot: Snapshot) -> None:
        if self._runner is not None:
            self._runner.show(snapshot)

    async def close(self) -> None:
        # The command that runs is waited for at the end only: motions have yet to end.
        if self._runner is not None:
            self._runner.end()

    def join(self) -> None:
        runner, self._runner = self._runner, None
        if runner is not None:
            runner.thread.join(_ENDS_WITHIN)


class WaitingChanges:
    """Changes that wait for their command: the newest of each link, route and pattern.

    A fault whose begin was not reported has no other report.

    Attributes:
        merged: number of changes that were merged since the last call of `told`.
    """

    def __init__(self) -> None:
        self._waiting: dict[tuple[str, str], FaultChange] = {}
        self._told: set[tuple[str, str]] = set()
        """Links, routes and patterns with a reported begin, and no reported end."""
        self.merged = 0

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def has_link(self) -> bool:
        """Whether a change of a link waits."""
        return any(isinstance(each.subject, LinkSnapshot) for each in self._waiting.values())

    def add(self, change: FaultChange) -> None:
        """Add a change. It replaces an earlier one of the same subject; if the queue is full, it is only counted."""
        earlier = self._waiting.pop(change.key, None)
        self.merged += earlier is not None
        # The change that this one replaces was never reported.
        before = change.before if earlier is None else earlier.before
        kind = change.kind
        if change.key not in self._told:
            if kind is ChangeKind.OVER:
                self.merged += 1
                return
            kind = ChangeKind.BEGUN
        elif kind is ChangeKind.BEGUN:
            kind = ChangeKind.CHANGED  # its end was not told
        if len(self._waiting) >= WAITING and not self._make_room(change):
            self.merged += 1
            return
        self._waiting[change.key] = replace(change, kind=kind, before=before)

    def _make_room(self, change: FaultChange) -> bool:
        """Drop the newest change of a topic for that of a link, or return False. A begin may be dropped, no end."""
        if not isinstance(change.subject, LinkSnapshot) and change.kind is not ChangeKind.OVER:
            return False
        for key, each in reversed(self._waiting.items()):
            if not isinstance(each.subject, LinkSnapshot) and each.kind is not ChangeKind.OVER:
                del self._waiting[key]
                self.merged += 1
                return True
        return False

    def in_order(self) -> list[FaultChange]:
        """Return all that wait: links first, then in the order in which they came."""
        return sorted(self._waiting.values(), key=lambda each: not isinstance(each.subject, LinkSnapshot))

    def told(self, changes: Iterable[FaultChange]) -> None:
        """Remove the reported changes."""
        self.merged = 0
        for each in changes:
            del self._waiting[each.key]
            if each.kind is ChangeKind.OVER:
                self._told.discard(each.key)
            else:
                self._told.add(each.key)


class StartLimit:
    """Limits how often the command starts."""

    def __init__(self) -> None:
        self._starts: deque[float] = deque(maxlen=STARTS)

    def take(self, now: float, *, for_link: bool = True) -> bool:
        """Return whether the command may start at `now` (s), and count the start if so.

        Args:
            for_link: whether a change of a link waits. So topics never use up all starts.
        """
        if self._starts and now - self._starts[-1] < EVERY:
            return False
        most = STARTS if for_link else STARTS - FOR_LINKS
        if sum(now - each < STARTS_WITHIN for each in self._starts) >= most:
            return False
        self._starts.append(now)
        return True


class _Runner:
    """Watches for faults and runs one command for them, on a thread of its own, until `end`."""

    def __init__(self, context: Context, command: tuple[str, ...], folder: Path) -> None:
        self._events = context.events
        self._clock = context.clock
        self._command = command
        self._base = folder
        self._watch = FaultWatch()
        self._waiting = WaitingChanges()
        self._limit = StartLimit()
        self._newest: Snapshot | None = None
        self._seen: Snapshot | None = None
        self._news = threading.Event()
        self._ends = False
        self._problem, self._told_at = "", float("-inf")
        self.thread = threading.Thread(target=self._run, name="rsb-on-fault", daemon=True)

    # --- from the I/O thread

    def show(self, snapshot: Snapshot) -> None:
        """Hand the thread a snapshot."""
        self._newest = snapshot
        self._news.set()

    def end(self) -> None:
        """End the thread soon, and the command that it runs."""
        self._ends = True
        self._news.set()

    # --- on the thread

    def _run(self) -> None:
        while not self._ends:
            self._wait(EVERY if self._waiting else None)
            if self._ends or self._seen is None or not self._waiting:
                continue
            if self._limit.take(self._clock.steady(), for_link=self._waiting.has_link):
                self._report(self._seen)

    def _wait(self, timeout: float | None) -> None:
        """Wait for a snapshot or the end, and look at the snapshot."""
        if not self._news.wait(timeout):
            return
        self._news.clear()
        snapshot = self._newest
        if snapshot is None or snapshot is self._seen or self._ends:
            return
        self._seen = snapshot
        for change in self._watch.find_changes(snapshot, self._clock.steady()):
            self._waiting.add(change)

    def _report(self, snapshot: Snapshot) -> None:
        changes = self._waiting.in_order()
        report, count = fault_report(
            changes,
            time=self._clock.time_ns() / 1e9,
            bridge=snapshot.name,
            role=snapshot.role,
            ongoing=self._watch.ongoing,
            merged=self._waiting.merged,
        )
        self._waiting.told(changes[:count])
        program = program_path(self._command[0], self._base)
        problem = "" if program is None else self._execute(program, report)
        self._note(problem if program is not None else program_problem(self._command[0], self._base))

    def _execute(self, program: Path, report: bytes) -> str:
        """Run the command to its end, and return its problem or an empty string."""
        try:
            process = subprocess.Popen(  # noqa: S603 -- the session file alone names it; a peer's texts are in no argument
                self._command,
                executable=program,
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                cwd=self._base,
                env={name: value for name, value in os.environ.items() if not name.startswith(_OF_THE_BRIDGE)},
                start_new_session=True,
            )
        except OSError as error:
            return program_problem(self._command[0], self._base) or f"{error.strerror}: does it begin with #!/bin/sh?"
        assert process.stdin is not None
        assert process.stdout is not None
        with process.stdout:
            with contextlib.suppress(OSError), process.stdin:  # does not block: a pipe holds more
                process.stdin.write(report)
            output = _Output(process.stdout.fileno())
            began, was_late = self._clock.steady(), False
            while not _has_exited(process):
                was_late = self._clock.steady() - began >= RUNS_FOR
                if self._ends or was_late:
                    self._terminate(process, output)
                    break
                # A full pipe would hold up the command.
                output.read()
                # No sleep: changes that come meanwhile are noted, and the end of the bridge is noticed at once.
                self._wait(_LOOK_EVERY)
            _signal_group(process, signal.SIGKILL)  # the command's children
            output.read()
        try:
            process.wait(_ENDS_WITHIN)
        except subprocess.TimeoutExpired:  # not even SIGKILL ends one that waits for a disk
            return "cannot be ended: it waits for a disk or a network folder"
        if output.kept and not self._ends:
            self._events.add(Level.DEBUG, ExporterCode.ON_FAULT, f"on_fault: {output.text}")
        if self._ends:
            return ""
        if was_late:
            return f"took longer than {RUNS_FOR:g} s and was ended"
        if process.returncode:
            ended = f"exit code {process.returncode}" if process.returncode > 0 else f"signal {-process.returncode}"
            return f"ended with {ended}{output.kept and ': '}{output.text}"
        return ""

    def _terminate(self, process: subprocess.Popen[bytes], output: _Output) -> None:
        """Ask a command to end, and wait a little."""
        _signal_group(process, signal.SIGTERM)
        ends = self._clock.steady() + (_ENDS_WITHIN_AT_STOP if self._ends else _ENDS_WITHIN)
        while not _has_exited(process) and self._clock.steady() < ends:
            output.read()
            self._wait(_LOOK_EVERY)

    def _note(self, problem: str) -> None:
        """Log a problem once, and again after a while if the command worked in between."""
        # Behind the colon is the command's output, which may differ each time.
        what, now = problem.partition(":")[0], self._clock.steady()
        if not problem:
            self._problem = ""
        elif what != self._problem and now - self._told_at >= _TOLD_EVERY:
            self._problem, self._told_at = what, now
            text = f"on_fault {self._command[0]}: {problem}; the bridge goes on"
            self._events.add(Level.WARNING, ExporterCode.ON_FAULT, text)


class _Output:
    """The first characters that a command writes.

    Attributes:
        kept: the characters, encoded.
    """

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self.kept = b""

    @property
    def text(self) -> str:
        """The characters as one text."""
        return self.kept.decode(errors="replace").strip()

    def read(self) -> None:
        """Read all that the pipe holds now."""
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._descriptor, _READ_SIZE)
            self.kept += data[: OUTPUT - len(self.kept)]


def _has_exited(process: subprocess.Popen[bytes]) -> bool:
    """Return whether a process has exited. It is not reaped, so that no other group gets its id."""
    try:
        return os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:  # this process ignores SIGCHLD
        return True


def _signal_group(process: subprocess.Popen[bytes], number: int) -> None:
    # PermissionError: all of the group are another user's by now, as with sudo.
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)
