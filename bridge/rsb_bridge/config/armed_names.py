"""The rules of a session's `armed`: names and patterns that have to be armed even without an entry."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.decoding import join, show
from rsb_bridge.config.pattern_rules import form_problems
from rsb_bridge.model.limits import DEADMAN_TIME, MAX_AGE
from rsb_bridge.model.session import Armed, Problem

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


def armed_problems(armed: Sequence[str | Armed]) -> Iterator[Problem]:
    """Yield the mistakes in a session's `armed`."""
    known: dict[Armed, int] = {}
    for at, each in enumerate(armed):
        here = join("armed", at)
        entry = Armed(each) if isinstance(each, str) else each
        yield from form_problems(entry.name, here if isinstance(each, str) else join(here, "name"), hidden=True)
        if entry.deadman and entry.deadman not in DEADMAN_TIME:
            message = f"{entry.deadman} is out of range: {DEADMAN_TIME} s, or 0 for none"
            yield Problem(join(here, "deadman"), message)
        if entry.max_age and entry.max_age not in MAX_AGE:
            yield Problem(join(here, "max_age"), f"{entry.max_age} is out of range: {MAX_AGE} s, or 0 for none")
        if known.setdefault(entry, at) != at:
            yield Problem(here, f"{show(entry.name)} is there already, as number {known[entry] + 1}: keep one")
