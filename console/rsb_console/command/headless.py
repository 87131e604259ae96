"""Bridging without a console: signals, events as log lines, a status line now and then, and systemd's notifications."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Self

from rsb_bridge.api import EngineError
from rsb_bridge.config.state_folder import state_folder
from rsb_bridge.control.bridges import AlreadyRunningError, serve
from rsb_bridge.control.control_sockets import ControlError
from rsb_bridge.engine import Engine, freeze_heap
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import acting
from rsb_bridge.model.snapshot import Event, Level
from rsb_bridge.model.text import keep_output_clean, one_line, plural
from rsb_bridge.model.wording import Wording
from rsb_console.command.formatting import StatusLines, json_event, json_status, summary, text_event
from rsb_console.command.shell import ALREADY_RUNNING, FAILURE, HUNG_UP, OK, encoded, print_error

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from concurrent.futures import Future
    from pathlib import Path
    from types import FrameType

    from rsb_bridge.api import EngineApi
    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import Reloaded, Snapshot

STATUS_EVERY = 5.0  # s, as the help of --status-every says. A round figure
_WAIT = 0.1  # s after which a signal is noticed, at the latest: until then, a robot that is driven goes on
_LOOK_EVERY = 1.0  # s between checks of an idle engine: no more often than it renews its snapshot
# These two and `_WAIT` are less than the 5 s that docs/headless.md promises, even if a peer or a reader hangs.
_STOPS_WITHIN = 4.0
_WRITTEN_WITHIN = 0.5
WAITING_LIMIT = 1 << 20
"""Bytes of lines that wait for a slow reader; a status line of 500 topics has 200 kB as JSON."""
TOO_SLOW = "standard output was read too slowly"


class HeadlessText(Wording):
    """Reports of a bridge that has no console, before its log begins."""

    RUNS_ALREADY = "{problem}. To attach to it: {command}"
    CONSOLE_CRASHED = (
        "the console has crashed; the bridge goes on without it until a signal stops it (Ctrl-C or SIGTERM)"
    )


def run_headless(
    path: Path, session: Session, *, log_format: str, on_hangup: str, status_every: float, control: Path | None
) -> int:
    """Bridge until a signal, or until this side's operator shuts the link down.

    Args:
        path: the session's file; key files are relative to its folder.
        log_format: ``text`` or ``json`` (one object a line).
        on_hangup: ``continue`` goes on when the terminal goes away; ``stop`` ends cleanly.
        control: path of the control socket, or None for one in the user's folder.

    Returns:
        The exit code.
    """
    # Fast DDS prints to standard output, where programs read a log of JSON.
    keep_output_clean()
    engine = Engine(session, base=path.parent, state=state_folder(os.environ))
    engine.use_file(path)
    # The signals are caught before the start, so that a signal meanwhile ends the bridge in order.
    with (
        Signals(ignore_hangup=on_hangup == "continue", has_terminal=_has_terminal()) as signals,
        contextlib.ExitStack() as resources,
    ):
        try:
            server = serve(engine, session, file=path, control=control)
            resources.callback(server.close)
        except AlreadyRunningError as error:
            print_error(HeadlessText.RUNS_ALREADY(problem=error, command=error.bridge.attach_command))
            return ALREADY_RUNNING
        except ControlError as error:
            print_error(f"the bridge runs, but no console can attach to it: {error}")
        try:
            engine.start()
        except EngineError as error:
            print_error(str(error))
            return FAILURE
        supervisor = Supervisor(os.environ)
        supervisor.ready()
        return bridge_until_told(
            engine, signals, log_format=log_format, status_every=status_every, supervisor=supervisor
        )


def bridge_on(engine: EngineApi, signals: Signals, *, crashed: bool) -> int:
    """Run the engine of a console that has ended or crashed, as `bridge_until_told`."""
    if crashed:
        print_error(HeadlessText.CONSOLE_CRASHED())
    code = bridge_until_told(engine, signals)
    return FAILURE if crashed else code


def bridge_until_told(
    engine: EngineApi,
    signals: Signals,
    *,
    log_format: str = "text",
    status_every: float = STATUS_EVERY,
    seconds: float | None = None,
    supervisor: Supervisor | None = None,
) -> int:
    """Run an engine until a signal, then stop it. Its log goes to standard output.

    Args:
        signals: entered already, so that no signal is missed.
        status_every: s between status lines.
        seconds: s after which it stops by itself, or None to run on.
    """
    freeze_heap()
    supervisor = supervisor or Supervisor({})  # which informs nobody
    format_event = json_event if log_format == "json" else text_event
    status = json_status if log_format == "json" else StatusLines().text

    def report(level: Level, code: EventCode, text: str) -> str:
        return format_event(Event(0, time.time(), level, code, text))

    def lines_lost(lost: int, reason: str) -> str:
        text = f"{lost:,} log {plural(lost, 'line')} lost: {reason}"
        return report(Level.WARNING, EventCode.LOG_LINES_LOST, text)

    writer = LogWriter(sys.stdout.fileno(), lines_lost)

    def log(events: Iterable[Event]) -> None:
        for event in events:
            if event.level is not Level.DEBUG:
                writer.write(format_event(event))

    ends = None if seconds is None else time.monotonic() + seconds
    next_status = time.monotonic() + status_every
    next_look = 0.0
    reload: Future[Reloaded] | None = None  # one at a time; the engine logs its outcome
    seen, reason = 0, ""
    while not reason:
        if events := engine.wait_for_events(seen, _WAIT):
            seen = events[-1].number
            log(events)
        if reload is not None and reload.done():
            reload = None
            supervisor.ready()
        if reload is None and signals.wants_reload:
            signals.wants_reload = False
            supervisor.reloading(time.monotonic_ns())
            with acting(signal.SIGHUP.name):
                reload = engine.reload()
        now = time.monotonic()
        reason = signals.caught or ("time is up" if ends and now >= ends else "")
        # A monitor may want a status line more often than an idle engine is looked at.
        if events or now >= min(next_look, next_status):
            next_look = now + _LOOK_EVERY
            shows = now >= next_status
            # Who looks has each route's figures renewed.
            snapshot = engine.snapshot() if shows else engine.recorded()
            if not snapshot.running:
                reason = reason or "the engine has ended by itself"
            elif engine.waits_for_operator:
                reason = reason or "the link was shut down on purpose"
            supervisor.show(snapshot)
            if shows:
                next_status = now + status_every
                writer.write(status(snapshot))
    writer.write(report(Level.INFO, EventCode.ENGINE_STOPPING, f"stopping: {reason}"))
    supervisor.stopping()
    # After the stop, no engine runs.
    failed = not engine.recorded().running
    engine.stop(_STOPS_WITHIN)
    # The stop itself has events, too.
    log(engine.events(seen))
    writer.close(_WRITTEN_WITHIN)
    return FAILURE if failed else HUNG_UP if signals.hung_up else OK


def _has_terminal() -> bool:
    """Whether the process has a controlling terminal (tty(4)), even if its input and output are redirected."""
    try:
        os.close(os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY))
    except OSError:
        return False
    return True


class Signals:
    """Catches the signals to a bridge, for as long as it is entered.

    SIGHUP means that the terminal has gone; if `ignore_hangup`, the bridge goes on. A process that never had a
    terminal, such as a service, gets it as a request to reload.

    Attributes:
        caught: the name of the first signal that ends the bridge, or empty.
        wants_reload: a reload was requested; cleared when it begins.
    """

    def __init__(self, *, ignore_hangup: bool, has_terminal: bool) -> None:
        self.caught = ""
        self.wants_reload = False
        self._hangup_reloads = not has_terminal
        self._ignore_hangup = ignore_hangup
        self._before: dict[int, Callable[[int, FrameType | None], object] | int | None] = {}

    def __enter__(self) -> Self:
        was_ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN  # by nohup(1)
        ignores_hangup = not self._hangup_reloads and (self._ignore_hangup or was_ignored)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            ignored = number == signal.SIGHUP and ignores_hangup
            self._before[number] = signal.signal(number, signal.SIG_IGN if ignored else self._catch)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            ends = number == signal.SIGINT and self.caught  # the process ends: one more would change its exit code
            signal.signal(number, signal.SIG_IGN if ends else handler)

    @property
    def hung_up(self) -> bool:
        return self.caught == signal.SIGHUP.name

    def _catch(self, number: int, _: FrameType | None) -> None:
        if number == signal.SIGHUP and self._hangup_reloads:
            self.wants_reload = True
        else:
            self.caught = self.caught or signal.Signals(number).name


class LogWriter:
    """Writes lines on a thread of its own.

    When too many wait, the oldest are dropped. As soon as writing works again, `lost_line` makes a line of the number
    of lines that were not written and the reason. The file descriptor stays open.
    """

    def __init__(self, fd: int, lost_line: Callable[[int, str], str]) -> None:
        self._fd = fd
        self._lost_line = lost_line
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._lost = 0
        self._reason = ""
        self._torn = False
        self._closing = False
        self._changed = threading.Condition()
        # A daemon: a write that never returns must not hold up the interpreter's exit.
        self._thread = threading.Thread(target=self._run, name="log-writer", daemon=True)
        self._thread.start()

    def write(self, text: str) -> None:
        """Hand over a line; returns at once."""
        line = encoded(f"{one_line(text)}\n")
        with self._changed:
            self._waiting.append(line)
            self._waiting_bytes += len(line)
            # The newest line stays even if it alone is beyond the limit, since it has the present state.
            while self._waiting_bytes > WAITING_LIMIT and len(self._waiting) > 1:
                self._waiting_bytes -= len(self._waiting.popleft())
                self._lost += 1
                self._reason = TOO_SLOW
            self._changed.notify()

    def close(self, timeout: float) -> None:
        """Wait until all lines are written, for at most `timeout` seconds."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closing)
                if not self._waiting:
                    return
                line = self._waiting.popleft()
                self._waiting_bytes -= len(line)
                lost, reason = self._lost, self._reason
            try:
                if lost:
                    self._write(encoded(f"{one_line(self._lost_line(lost, reason))}\n"))
                    with self._changed:
                        # It does not become 0 if more lines are lost while this one is written.
                        self._lost -= lost
                self._write(line)
            except OSError as error:
                with self._changed:
                    self._lost += 1
                    self._reason = error.strerror or str(error)

    def _write(self, line: bytes) -> None:
        if self._torn:  # do not continue a line that was written in part
            line = b"\n" + line
        written = 0
        try:
            while written < len(line):
                written += os.write(self._fd, line[written:])
        finally:
            # If nothing was written, the output still ends as before.
            self._torn = written < len(line) if written else self._torn


class Supervisor:
    """Reports the bridge's state to systemd, if the environment has the address that systemd listens on."""

    def __init__(self, environ: Mapping[str, str]) -> None:
        address = environ.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address  # an abstract socket of Linux
        self._alive_at = 0.0
        self._status = ""

    def ready(self) -> None:
        """Report that the bridge has started, or has reloaded."""
        self._tell("READY=1")

    def reloading(self, monotonic_ns: int) -> None:
        """Report that the session file is about to be read again; `ready` follows. The time is CLOCK_MONOTONIC's."""
        self._tell(f"RELOADING=1\nMONOTONIC_USEC={monotonic_ns // 1000}")

    def show(self, now: Snapshot) -> None:
        """Report the bridge's state. It works as long as its I/O thread renews its snapshots."""
        # An engine that hangs renews no snapshot; without WATCHDOG, systemd restarts it.
        if now.time == self._alive_at:
            return
        self._alive_at = now.time
        status = summary(now)
        self._tell("WATCHDOG=1" if status == self._status else f"WATCHDOG=1\nSTATUS={status}")
        self._status = status

    def stopping(self) -> None:
        self._tell("STOPPING=1")

    def _tell(self, state: str) -> None:
        if self._address:
            with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
                # A systemd that does not read must not hold up the loop, which also sees the signals.
                notify.setblocking(False)
                notify.sendto(state.encode(), self._address)
