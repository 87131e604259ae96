"""Writes events and the time line to disk, on a thread of its own: a slow or full disk holds nobody up."""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING

from rsb_bridge.history import history_files
from rsb_bridge.history.history_files import EventFile, HistoryFileError
from rsb_bridge.history.state_folder import Claim, Files
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.names import file_stem
from rsb_bridge.model.shortage import why_not_written
from rsb_bridge.model.snapshot import Level

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_bridge.history.recorder import Recorder
    from rsb_bridge.model.clock import Clock
    from rsb_bridge.telemetry.event_log import EventLog

_EVERY = 0.5
"""s from one writing to the next: what comes in between is written together."""
_LOOKS_EVERY = 2.0
"""s after which it looks whether the time line is due, if there is no event before."""
_RETRIED_EVERY = 5.0
SAVED_EVERY = 120.0
_SAVED_SOON = 5.0
"""s from one save to the next where an outage has begun or ended, or an operator did something."""
_ANSWERED_WITHIN = 10.0
SET_ASIDE = ".bad"


class Disk:
    """Keeps what one engine reports and a recorder remembers, from `start` to `stop`.

    What cannot be written is told once, as an event; the events wait in the engine's log, as many as that keeps.

    Args:
        folder: where the files are.
        name: of the session.
        role: ``client`` or ``server``.
        events: of the engine.
        recorder: has the time line; goes on from the file that an earlier process left.
        clock: the machine's.
    """

    def __init__(self, folder: Path, name: str, role: str, events: EventLog, recorder: Recorder, clock: Clock) -> None:
        self._folder, self._name, self._role = folder, name, role
        self._events = events
        self._recorder = recorder
        self._clock = clock
        self._claim: Claim | None = None
        self._file: EventFile | None = None
        self._written = 0
        self._is_restored = False
        self._saved_at = self._tried_at = float("-inf")
        self._saved_changes = 0
        self._trouble = ""
        self._missing = 0
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="rsb-disk", daemon=True)

    def start(self) -> None:
        """Begin: restore the time line, and write."""
        self._thread.start()

    def stop(self, timeout: float) -> None:
        """Write the last events and the time line; the recorder has stopped.

        Args:
            timeout: s to wait for that, at most.
        """
        self._ends.set()
        self._events.wake()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _run(self) -> None:
        while not self._ends.is_set():
            written = self._written
            self.turn()
            if self._trouble or written != self._written:
                self._ends.wait(_EVERY)
            elif self._is_restored:
                pause = _EVERY if self._is_changed else _LOOKS_EVERY
                self._events.wait(self._written, pause, self._ends.is_set)
        self._tried_at = float("-inf")
        self.turn(last=True)
        if self._file is not None:
            self._file.close()
        if self._claim is not None:
            self._claim.close()

    def turn(self, *, last: bool = False) -> None:
        """Write what is due.

        Args:
            last: nothing comes after it.
        """
        now = self._clock.steady()
        if self._trouble and now - self._tried_at < _RETRIED_EVERY:
            return
        self._tried_at = now
        try:
            if self._claim is None:
                self._open()
            self._restore()
            self._write_events()
            if self._is_restored and (last or self._is_due(now)):
                self._save(now)
        except (OSError, ValueError) as error:
            self._failed(why_not_written(error, self._folder) if isinstance(error, OSError) else str(error))
            self._restore()
        else:
            self._works()

    # --- files

    def _open(self) -> None:
        self._claim = Claim(self._folder, self._name, self._role)
        self._file = EventFile(self._claim.files.events)

    @property
    def _files(self) -> Files:
        return Files(self._folder, file_stem(self._name)) if self._claim is None else self._claim.files

    def _restore(self) -> None:
        """Once: have the recorder go on from what is in the file, even where it cannot be replaced now."""
        if self._is_restored:
            return
        path = self._files.history
        try:
            saved = history_files.read_history(path)
            events = tuple(history_files.read_events(self._files.events, saved.time))
            self._recorder.ask(lambda: self._recorder.restore(saved, events)).result(_ANSWERED_WITHIN)
        except TimeoutError:
            return
        except FileNotFoundError:
            pass
        except (HistoryFileError, ValueError) as error:
            aside = path.with_name(path.name + SET_ASIDE)
            with contextlib.suppress(OSError):  # then the first save replaces it, or says why it cannot
                path.replace(aside)
            text = f"{path}: {error}. It is set aside as {aside.name}, and the time line begins anew"
            self._events.add(Level.WARNING, EventCode.LOG_HISTORY_SET_ASIDE, text)
        self._is_restored = True

    def _write_events(self) -> None:
        events = self._events.after(self._written)
        if not events:
            return
        assert self._file is not None
        self._file.write([event for event in events if event.level is not Level.DEBUG])
        self._missing += events[0].number - self._written - 1
        self._written = events[-1].number

    @property
    def _is_changed(self) -> bool:
        return self._recorder.changes != self._saved_changes

    def _is_due(self, now: float) -> bool:
        return now - self._saved_at >= (_SAVED_SOON if self._is_changed else SAVED_EVERY)

    def _save(self, now: float) -> None:
        self._saved_changes = self._recorder.changes
        with contextlib.suppress(TimeoutError):
            saved = self._recorder.ask(self._recorder.save).result(_ANSWERED_WITHIN)
            history_files.write_history(self._files.history, saved)
            self._saved_at = now

    # --- what is told

    def _failed(self, reason: str) -> None:
        if not self._trouble:
            text = f"{self._folder}: {reason}. Events and the time line are not kept on disk; the bridge goes on"
            self._trouble = reason
            self._events.add(Level.WARNING, EventCode.LOG_FILE_FAILED, text)

    def _works(self) -> None:
        if self._trouble:
            self._trouble = ""
            missing = f"; {self._missing:,} events are missing" if self._missing else ""
            self._missing = 0
            text = f"{self._folder}: events and the time line are kept on disk again{missing}"
            self._events.add(Level.INFO, EventCode.LOG_FILE_AGAIN, text)
