"""Shows an engine to ROS's instruments and to Prometheus, and reports its faults to the session's command."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.diagnostics import Diagnostics
from rsb_bridge.fault_hook import FaultHook
from rsb_bridge.metrics import Metrics

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from rsb_bridge.context import Context
    from rsb_bridge.model.snapshot import Snapshot


class Instruments:
    """All instruments of one engine. They belong to the I/O thread; a failing one ends nothing else.

    Args:
        context: the session, and what every part shares.
        look: gives the newest snapshot, on any thread.
        folder: gives the folder of the session file.

    Attributes:
        by_key: instruments to restart when their key of the session changes.
    """

    def __init__(self, context: Context, look: Callable[[], Snapshot], folder: Callable[[], Path]) -> None:
        self._diagnostics = Diagnostics(context)
        self._metrics = Metrics(context, look)
        self._fault_hook = FaultHook(context, folder)
        self.by_key: tuple[tuple[tuple[str], Callable[[], None]], ...] = (
            (("diagnostics_topic",), self._diagnostics.open),
            (("metrics",), self._metrics.open),
            (("on_fault",), self._fault_hook.open),
        )

    def open(self) -> None:
        """Show everything that the session says, from now on."""
        for _, start in self.by_key:
            start()

    def tick(self, snapshot: Snapshot) -> None:
        """To be called once a second, with the newest snapshot."""
        self._diagnostics.tick(snapshot)
        self._fault_hook.tick(snapshot)

    def close(self) -> None:
        """Show nothing more. May be called twice."""
        self._diagnostics.close()
        self._fault_hook.close()
        self._metrics.close()

    def join(self) -> None:
        """Wait for what `close` ended, a second at most."""
        self._fault_hook.join()
