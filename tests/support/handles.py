"""A process that somebody else started and reaps: its number may soon be another one's, its handle never is."""

from __future__ import annotations

import contextlib
import os
import select
import signal

from tests.support.waiting import eventually


class Handle:
    """The handle of a process, from when it was started on (pidfd_open(2)).

    The kernel reuses a process's number after minutes: a kill by number, at the end of a test, hit another process.
    """

    def __init__(self, pid: int) -> None:
        try:
            self._descriptor = os.pidfd_open(pid)
        except ProcessLookupError:  # it has ended already
            self._descriptor = -1

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self._descriptor >= 0 and not select.select([self._descriptor], [], [], 0)[0]

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal.

        Raises:
            ProcessLookupError: it has ended.
        """
        if self._descriptor < 0:
            raise ProcessLookupError
        signal.pidfd_send_signal(self._descriptor, number)

    def kill(self) -> None:
        """kill -9, wait until it is gone, and let it go."""
        with contextlib.suppress(ProcessLookupError):  # it may have ended
            self.signal(signal.SIGKILL)
        eventually(lambda: not self.running)
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
