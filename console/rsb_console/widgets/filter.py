"""The filter of a list: its language (terms that must match, terms with ``!`` that must not), and its prompt."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from textual.binding import Binding
from textual.containers import Horizontal
from textual.message import Message
from textual.widgets import Input, Static

from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from textual.app import ComposeResult

COLUMNS = ("state", "kind", "topic", "robot", "group", "via", "type", "why")
_TERM = re.compile(rf"(?P<not>!*)(?:(?P<column>{'|'.join(COLUMNS)}):)?(?P<text>.*)", re.IGNORECASE)


class PatternProblem(Wording):
    """Mistakes in a pattern."""

    NO_REGEX = "not a regular expression: {error}"


class PatternError(ValueError):
    """Not a regular expression; the message has the place."""


class _Term(NamedTuple):
    column: str  # to search, or an empty string for all columns
    regex: re.Pattern[str]
    excludes: bool  # it must not match


@dataclass(frozen=True)
class RowFilter:
    """A filter: ``state:down robot1 !scan``. All terms must match; one with ``!`` must not.

    Each term is a regular expression without spaces. It searches one column if it begins with that column's name, and
    otherwise all. A term without text, such as a single ``!``, is ignored.
    """

    text: str
    _terms: tuple[_Term, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_terms", tuple(filter(None, map(_term, self.text.split()))))

    @classmethod
    def or_plain(cls, text: str) -> RowFilter:
        """Read `text` as a filter, or as plain words if it is not a valid one."""
        try:
            return cls(text)
        except PatternError:
            return cls(" ".join(map(re.escape, text.split())))

    def __bool__(self) -> bool:
        return bool(self._terms)

    def matches(self, columns: Mapping[str, str], hidden: Collection[str] = ()) -> bool:
        """Whether to show a line.

        Args:
            columns: cell texts by column; ``""`` holds the rest of the line.
            hidden: columns that only their name finds.
        """
        anywhere = [text for name, text in columns.items() if name not in hidden]
        return all(
            any(map(term.regex.search, [columns.get(term.column, "")] if term.column else anywhere))
            is not term.excludes
            for term in self._terms
        )


def table_title(name: str, pattern: RowFilter | None, *, faults_only: bool, shown: int, rows: int) -> list[str]:
    """Return the parts of a table's title: its name, what filters it, and then how many of its rows it shows."""
    filters = ["faults only"] if faults_only else []
    if pattern is not None:
        filters.append(f"/{pattern.text}")
    return [name, *filters, f"{shown} of {rows}"] if filters else [name]


def _term(typed: str) -> _Term | None:
    parts = _TERM.fullmatch(typed)
    if parts is None or not parts["text"]:
        return None
    try:
        regex = re.compile(parts["text"], re.IGNORECASE)
    except re.error as error:
        raise PatternError(PatternProblem.NO_REGEX(error=error)) from None
    return _Term((parts["column"] or "").lower(), regex, bool(parts["not"]))


class Prompt(Horizontal):
    """``/`` and an input. Typing filters at once; enter keeps the filter, escape restores the previous one.

    Args:
        columns: a hint at the columns that a term may begin with.
    """

    BINDINGS: ClassVar = [Binding("escape", "cancel", show=False)]

    class Changed(Message):
        """A valid pattern, or none, was typed."""

        def __init__(self, pattern: RowFilter | None) -> None:
            super().__init__()
            self.pattern = pattern

    class Closed(Message):
        """The operator left the prompt."""

    def __init__(self, columns: str = "state: kind: robot: type: via: why:") -> None:
        super().__init__(id="prompt")
        self._columns = columns
        self.display = False
        self._before = ""

    def compose(self) -> ComposeResult:
        yield Static(" /", id="sign")
        yield Input(id="pattern", placeholder=f"terms that match, !terms that do not; {self._columns}")
        yield Static("", id="problem", classes="problem")

    def open(self, text: str) -> None:
        """Ask for a filter, beginning with `text`. The focus moves at once, so that no key is lost."""
        self._before = text
        self.display = True
        field = self.query_one(Input)
        # The text that is there filters already; only what is typed is news.
        with self.prevent(Input.Changed):
            field.value = text
        self.query_one("#problem", Static).update("")
        self.screen.set_focus(field)

    def on_input_changed(self, event: Input.Changed) -> None:
        event.stop()
        problem = self.query_one("#problem", Static)
        try:
            pattern = RowFilter(event.value) or None
        except PatternError as error:
            problem.update(str(error))
            return  # the filter of before stays, for example while a bracket is still open
        problem.update("")
        self.post_message(self.Changed(pattern))

    def on_input_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        self._close()

    def action_cancel(self) -> None:
        self.post_message(self.Changed(RowFilter(self._before) if self._before else None))
        self._close()

    def _close(self) -> None:
        self.display = False
        self.post_message(self.Closed())
