"""What an operator is told of a route beside its state: each thing once, however often it is found again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level

if TYPE_CHECKING:
    from collections.abc import Callable


class Notices:
    """One route's.

    Attributes:
        loop: why the open route carries nothing: it would close a loop of bridges; empty: it would not.
        warning: what an operator should know although messages flow; empty: nothing.
        last_error: the last error, or empty.
        undelivered: why the last message was not carried; empty: it was, or none has come in this opening.
    """

    def __init__(self, log: Callable[[Level, EventCode, str], None]) -> None:
        self.loop = ""
        self.warning = ""
        self.last_error = ""
        self.undelivered = ""
        self._log = log
        self._told = ""
        self._doubted = ""

    def error(self, code: EventCode, reason: str, level: Level = Level.ERROR) -> None:
        """The route has failed. The next tries need not say the same, until messages flow."""
        self.last_error = reason
        if reason != self._told:
            self._told = reason
            self._log(level, code, reason)

    def flowing(self) -> None:
        """Messages flow: what fails from now on is said again."""
        self._told = self.undelivered = ""

    def message_error(self, code: EventCode, reason: str) -> None:
        """A message cannot be carried, while others can."""
        self.undelivered = reason
        if reason != self.last_error:
            self.last_error = reason
            self._log(Level.ERROR, code, reason)

    def set_loop(self, reason: str) -> None:
        """The route is refused for as long as it would close a loop; empty: it would not. It stays open."""
        if reason and not self.loop:
            self.error(EventCode.ROUTE_LOOP, reason)
        elif self.loop and not reason:
            self._told = ""
            self._log(Level.INFO, EventCode.ROUTE_LOOP_GONE, "messages would no longer loop")
        self.loop = reason

    def set_warning(self, warning: str) -> None:
        """Say what an operator should know although messages flow; empty: nothing."""
        if warning and warning != self.warning:
            self._log(Level.WARNING, EventCode.ROUTE_TYPE_CHANGED, warning)
        self.warning = warning

    def doubt(self, instance: str, remedy: str) -> None:
        """Say, once for each of the peer's processes, that its counts cannot be right, and what is done about it."""
        if self._doubted != instance:
            self._doubted = instance
            text = f"the other side reports counts that cannot be right; {remedy}"
            self._log(Level.WARNING, EventCode.ROUTE_IMPLAUSIBLE_REPORT, text)

    def closed(self) -> None:
        """The opening has ended, and with it what holds only while it lasts."""
        self.loop = self.warning = self.undelivered = ""
