"""Where what is known of robots comes from. A further kind of source is one more module here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rsb_bridge.control.remote_engine import RemoteEngine
    from rsb_bridge.model.robot_summary import RobotSummary


class FleetSource(Protocol):
    """Knows some robots, no two of the same name. All but `start`, `wait` and `open` answer at once.

    Attributes:
        kind: what it is, in a word: ``server`` or ``fleet``.
        name: what an operator calls it: ``control``, the server's name. No other source has it.
    """

    kind: str
    name: str

    @property
    def problem(self) -> str:
        """Why nothing is known at present; empty: something is."""
        ...

    def start(self) -> None:
        """Begin to know robots.

        Raises:
            EngineError: that cannot be done.
        """
        ...

    def wait(self) -> None:
        """Wait until each robot has said how it is, or why nothing is known of it; some seconds at most."""
        ...

    def stop(self) -> None:
        """End it; `robots` gives what it gave last."""
        ...

    def robots(self) -> list[RobotSummary]:
        """The robots as they are now, those too that are not there."""
        ...

    def open(self, robot: str, *, read_only: bool) -> RemoteEngine:
        """An engine that shows and changes only what is of one robot; the caller stops it.

        It takes some seconds at most.

        Raises:
            EngineError: that cannot be done.
        """
        ...
