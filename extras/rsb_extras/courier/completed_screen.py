"""A page of what is in a completed recording: per topic what came live, what was fetched, and what neither side has."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding
from textual.screen import ModalScreen

from rsb_bridge.feature_api import Wording
from rsb_console.feature_console import Dialog, ScrolledLines, wrapped
from rsb_extras.courier.completed_text import gap_texts, summary_texts, topic_name

if TYPE_CHECKING:
    from collections.abc import Iterator

    from textual.app import ComposeResult

    from rsb_console.feature_console import Line
    from rsb_extras.courier.completed_recording import CompletedRecording, CompletedTopic

_HELP = "↑ ↓ scroll   esc close"
_WIDTH = 72  # cells, until the screen is laid out


class CompletedScreenText(Wording):
    WHOLE = "no message is known to be missing"
    HEADINGS = "{here:>11}  {fetched:>11}  {missing:>11}  {topic}"


class CompletedScreen(ModalScreen[None]):
    """What is in a file that completes what came live, the topics with gaps first.

    Args:
        path: of the file, if the bridge has written it since it began.
    """

    BINDINGS: ClassVar = [Binding("escape,q,m", "dismiss", show=False)]
    AUTO_FOCUS = "#completed"
    DEFAULT_CSS = "#completed { height: 1fr; background: $surface; }"

    def __init__(self, name: str, completed: CompletedRecording, path: str = "") -> None:
        super().__init__()
        self._of, self._completed, self._path = name, completed, path
        self.lines = ScrolledLines(id="completed")

    def compose(self) -> ComposeResult:
        yield Dialog(self._of, self.lines, keys=_HELP, shape="-high")

    def on_mount(self) -> None:
        self.call_after_refresh(self._show)

    def on_resize(self) -> None:
        self._show()

    def _show(self) -> None:
        self.lines.put([*_lines(self._completed, self._path, self.lines.size.width or _WIDTH)])


def _lines(completed: CompletedRecording, path: str, width: int) -> Iterator[Line]:
    if path:
        yield from wrapped(path, width, "strong")
    for text in summary_texts(completed):
        yield from wrapped(text, width, "dim")
    if not any(map(_lacks, completed.topics)):
        yield from wrapped(CompletedScreenText.WHOLE(), width, "ok")
    yield ()
    yield ((_columns("HERE", "FETCHED", "MISSING", "TOPIC"), "head"),)
    for topic in sorted(completed.topics, key=lambda each: not _lacks(each)):
        look = "stale" if _lacks(topic) else ""
        figures = f"{topic.live:,}", f"{topic.fetched:,}", _missing(topic)
        yield ((_columns(*figures, topic_name(topic)), look),)
        for text in gap_texts(topic):
            yield from wrapped(text, width, "dim")


def _columns(here: str, fetched: str, missing: str, topic: str) -> str:
    return CompletedScreenText.HEADINGS(here=here, fetched=fetched, missing=missing, topic=topic)


def _lacks(topic: CompletedTopic) -> bool:
    return bool(topic.missing or topic.gaps)


def _missing(topic: CompletedTopic) -> str:
    """Return how many messages neither side has; nobody may know that of some times."""
    if all(gap.messages is not None for gap in topic.gaps):
        return f"{topic.missing:,}"
    return f"{topic.missing:,} + ?" if topic.missing else "?"
