"""How an engine is seen by the instruments of others: ROS's and Prometheus's."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.diagnostics import Diagnostics
from rsb_bridge.metrics import Metrics

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.model.snapshot import Snapshot


class Instruments:
    """All of one engine. They belong to the I/O thread; what does not work ends nothing else.

    Attributes:
        by_key: what begins anew where these keys of the session have changed.
    """

    def __init__(self, context: Context, look: Callable[[], Snapshot]) -> None:
        self._diagnostics = Diagnostics(context)
        self._metrics = Metrics(context, look)
        self.by_key: tuple[tuple[tuple[str], Callable[[], None]], ...] = (
            (("diagnostics_topic",), self._diagnostics.open),
            (("metrics",), self._metrics.open),
        )

    def open(self) -> None:
        """Show everything that the session says, from now on."""
        for _, start in self.by_key:
            start()

    def tick(self, snapshot: Snapshot) -> None:
        """To be called once a second, with the newest snapshot."""
        self._diagnostics.tick(snapshot)

    def close(self) -> None:
        """Show nothing more. May be called twice."""
        self._diagnostics.close()
        self._metrics.close()
