"""What a bridge that does not run has left on disk."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.history import event_file, history_file
from rsb_bridge.history.history_file import HistoryFileError
from rsb_bridge.history.timeline import FROM_THE_FUTURE, Timeline
from rsb_bridge.model.history import KEPT_FOR

if TYPE_CHECKING:
    from rsb_bridge.history.folders import Files
    from rsb_bridge.model.history import HistoryReport


def report(files: Files, now: float, seconds: float) -> HistoryReport:
    """What happened in the last so many s.

    Args:
        files: of the bridge.
        now: s since the epoch.
        seconds: 24 h at most.

    Raises:
        HistoryFileError: there is no time line, or none that can be used.
    """
    try:
        saved = history_file.read(files.history)
        timeline = Timeline.restore(saved, saved.name, saved.role)
    except FileNotFoundError:
        raise HistoryFileError(f"{files.history}: there is no such file") from None
    except (HistoryFileError, ValueError) as error:
        raise HistoryFileError(f"{files.history}: {error}") from None
    if saved.time - now > KEPT_FOR:
        raise HistoryFileError(f"{files.history}: {FROM_THE_FUTURE}")
    end = max(now, saved.time)
    timeline.go_on(event for event in event_file.read(files.events, saved.time) if event.time <= end)
    return timeline.report(end, seconds, running=False)
