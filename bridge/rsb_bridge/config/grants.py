"""The entries of `allow` and `deny`: read from what somebody types, and their rules."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rsb_bridge.config.decoding import join, read, show
from rsb_bridge.config.yaml_text import SessionError, read_yaml
from rsb_bridge.model import transports
from rsb_bridge.model.limits import RATE
from rsb_bridge.model.session import Grant, May, Problem

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.benchmark import Leave
    from rsb_bridge.model.session import Client, Session

TOPIC_USES: Final[tuple[May, May]] = ("publish", "read")
CALL_USES: Final[tuple[May, May]] = ("call", "serve")
"""What a peer may do here that sends messages or requests, and that takes them."""
_MOST_LEAVE = 1e6
_ENTRY = re.compile(r"\{[^{}]*\}?|[^\s,{]+")
"""A mapping, or a word: entries have blanks or commas between them."""


class GrantError(ValueError):
    """What was typed is no entry of `allow` or `deny`; the message says why."""


def protocols_of(grant: Grant) -> tuple[str, ...]:
    """What may carry the topics of an entry; empty: anything."""
    return grant.protocol if isinstance(grant.protocol, tuple) else (grant.protocol,) if grant.protocol else ()


def typed_grants(text: str) -> tuple[str | Grant, ...]:
    """The entries in a line: ``/camera/*, {topics: /cmd_vel, may: publish, max_rate: 10}``.

    Raises:
        GrantError: one of them is none.
    """
    return tuple(_typed(entry) for entry in _ENTRY.findall(text))


def _typed(entry: str) -> str | Grant:
    if not entry.startswith("{"):
        return entry
    problems: list[Problem] = []
    try:
        data = read_yaml(entry, Path()).data
    except SessionError as error:
        raise GrantError(f"{show(entry)}: {error.problems[0].message}") from None
    grant = read(data, Grant, problems)
    if problems:
        raise GrantError("; ".join(map(str, problems)))
    return grant


def allowing(entry: str | Grant) -> Grant:
    """An entry of `allow`; a pattern alone is about topics, so that nobody allows services unawares."""
    return Grant(entry) if isinstance(entry, str) else entry


def denying(entry: str | Grant) -> Grant:
    """An entry of `deny`; a pattern alone is about whatever has such a name."""
    return Grant(entry, entry) if isinstance(entry, str) else entry


def grant_problems(holder: Client | Session, location: str) -> Iterator[Problem]:
    """Mistakes in `allow` and `deny`."""
    for key, entries in (("allow", holder.allow), ("deny", holder.deny)):
        for at, grant in enumerate(entries):
            here = join(join(location, key), at)
            if isinstance(grant, str):
                yield from _pattern_problems(grant, "topic", here)
                continue
            yield from _subject_problems(grant, here)
            if grant.protocol == ():
                yield Problem(join(here, "protocol"), "the list is empty: leave protocol out, or name one")
            if key == "deny" and grant.max_rate is not None:
                yield Problem(join(here, "max_rate"), "belongs under allow: what is denied has no rate")
            yield from rate_problems(grant.max_rate, join(here, "max_rate"))


def _subject_problems(grant: Grant, here: str) -> Iterator[Problem]:
    """Mistakes in what an entry is about, and in what may be done with that."""
    if grant.topics is None and grant.services is None:
        yield Problem(join(here, "topics"), "missing: give a pattern as topics, or as services")
        return
    if grant.topics is not None and grant.services is not None:
        yield Problem(join(here, "services"), "has topics beside it: make an entry of each")
        return
    if grant.topics is not None:
        noun, uses, others = "topic", TOPIC_USES, "services"
        yield from _pattern_problems(grant.topics, noun, join(here, "topics"))
    else:
        noun, uses, others = "service", CALL_USES, "topics"
        yield from _pattern_problems(grant.services or "", noun, join(here, "services"))
        for protocol in protocols_of(grant):
            if not transports.named(protocol).reliable:
                yield Problem(join(here, "protocol"), f"{protocol} carries no calls: leave it out")
    if grant.may is not None and grant.may not in uses:
        message = f"{grant.may} is for {others}: a {noun} takes {' or '.join(uses)}, or leave may out for both"
        yield Problem(join(here, "may"), message)


def _pattern_problems(pattern: str, noun: str, location: str) -> Iterator[Problem]:
    if not (pattern.startswith(("/", "*")) and pattern.isprintable()):
        yield Problem(location, f"{show(pattern)} matches no {noun}: a pattern begins with / or * (/robot1/*)")
    elif pattern.endswith("/") or "//" in pattern:
        message = f"{show(pattern)} matches no {noun}: names have one / before each part, and none at the end"
        yield Problem(location, message)


def leave_problems(leave: Leave | None, location: str) -> Iterator[Problem]:
    """Mistakes in what a benchmark may cause."""
    if leave is None:
        return
    yield from rate_problems(leave.max_rate, join(location, "max_rate"))
    for key, value in (("seconds", leave.seconds), ("megabytes", leave.megabytes)):
        if not 0 < value <= _MOST_LEAVE:
            yield Problem(join(location, key), f"{value:g} is out of range: above 0, at most {_MOST_LEAVE:g}")


def rate_problems(rate: float | None, location: str) -> Iterator[Problem]:
    """Whether a rate limit is in its range."""
    if rate is not None and rate not in RATE:
        yield Problem(location, f"{rate} is out of range: {RATE} Hz, or leave it out")
