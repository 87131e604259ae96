"""One finding about this machine, and how checks make it."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Any, NamedTuple

from rsb_bridge.model.text import sanitize_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping


class Grade(StrEnum):
    """The grade of a finding, from good to bad."""

    OK = "ok"
    NOTE = "note"
    """Something is missing that only some bridges need."""
    UNKNOWN = "unknown"
    """It cannot be found out; the text says why."""
    WARNING = "warning"
    """It works, but worse, or not in all cases."""
    ERROR = "error"
    """No bridge runs, or this session does not."""


class Finding(NamedTuple):
    """One finding.

    Attributes:
        code: name of the examined thing, for programs: ``udp_buffers``.
        subject: name of the examined thing, for people.
        remedy: a command or advice, or an empty string.
        facts: figures and names for programs.
    """

    code: str
    grade: Grade
    subject: str
    text: str
    remedy: str = ""
    facts: Mapping[str, Any] = {}

    def as_json(self) -> dict[str, Any]:
        """Return it with JSON's types."""
        return {**self._asdict(), "grade": str(self.grade), "facts": dict(self.facts)}


class Check(NamedTuple):
    """One check.

    Attributes:
        run: yields them; it raises OSError if it cannot find out.
    """

    code: str
    subject: str
    run: Callable[[], Iterable[Finding]]


def examine(checks: Iterable[Check]) -> Iterator[Finding]:
    """Run checks. One that cannot find out or has a defect is a finding, too, and the others still run."""
    for check in checks:
        try:
            yield from check.run()
        except (OSError, ValueError) as error:
            yield Finding(check.code, Grade.UNKNOWN, check.subject, sanitize_text(str(error)))
        except Exception as error:  # noqa: BLE001 -- the operator needs the other findings
            problem = sanitize_text(f"{type(error).__name__}: {error}")
            text, remedy = f"internal error of this check: {problem}", "report it as an issue, with this output"
            yield Finding(check.code, Grade.UNKNOWN, check.subject, text, remedy, {"internal_error": True})


def worst(findings: Iterable[Finding]) -> Grade:
    """Return the worst grade of some findings."""
    grades = list(Grade)
    return max((each.grade for each in findings), key=grades.index, default=Grade.OK)
