"""Records an engine's history, answers questions about it, and keeps it on disk if the engine has a state folder."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EngineObserver
from rsb_extras.history.history_data import ReportHistory
from rsb_extras.history.history_files import Disk
from rsb_extras.history.recorder import Recorder

if TYPE_CHECKING:
    from concurrent.futures import Future

    from rsb_bridge.engine.engine import Engine
    from rsb_extras.history.history_data import HistoryReport

_WRITTEN_WITHIN = 0.5
"""s for the files, even if the recorder has used up all: else they lack the end. A round figure."""


class HistoryKeeper(EngineObserver):
    def __init__(self, engine: Engine) -> None:
        session, self._clock = engine.session, engine.clock
        self._recorder = Recorder(session.name, session.role, engine.log, lambda: engine.snapshots.latest, engine.clock)
        self._disk: Disk | None = None
        if engine.state is not None:
            self._disk = Disk(engine.state, session.name, session.role, engine.log, self._recorder, engine.clock)
        self.answers = {ReportHistory: self._report}

    def start(self) -> None:
        self._recorder.start()
        if self._disk is not None:
            self._disk.start()

    def stop(self, timeout: float) -> None:
        ends = self._clock.steady() + timeout
        self._recorder.stop(timeout)
        if self._disk is not None:  # it writes what the recorder notes last
            self._disk.stop(max(_WRITTEN_WITHIN, ends - self._clock.steady()))

    def _report(self, command: ReportHistory) -> Future[HistoryReport]:
        seconds = command.seconds if command.seconds > 0 else 0.0  # NaN is not greater than 0, either
        return self._recorder.history(seconds, command.link)
