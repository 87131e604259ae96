"""The entries of `allow` and `deny`: what the other side of a link may do, or may not."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from rsb_bridge.config.decoding import join, read, show, under
from rsb_bridge.config.topic_rules import range_problems
from rsb_bridge.config.yaml_text import SessionError, inline, read_yaml
from rsb_bridge.model import transports
from rsb_bridge.model.session import Grant, May, Problem
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.session import Client, Kind, Session

TOPIC_USES: Final[tuple[May, May]] = ("publish", "read")
CALL_USES: Final[tuple[May, May]] = ("call", "serve")
"""The two rights of a peer: to send messages or requests here, and to take them."""
TOPIC_ENTRIES: Final[tuple[May, ...]] = (*TOPIC_USES, "look")  # the right to read includes the right to look
_ENTRY = re.compile(r"\{[^{}]*\}?|[^\s,{]+")
"""A mapping, or a word: entries have blanks or commas between them. Without its last brace, YAML refuses it."""


class RightsMistake(Wording):
    """A mistake in an entry of `allow` or `deny`."""

    NO_PROTOCOLS = "the list is empty: leave protocol out, or name one"
    RATE_OF_DENIED = "belongs under allow: what is denied has no rate"
    NO_PATTERN = "missing: give a pattern as topics, or as services"
    BOTH = "topics and services are in one entry: make an entry for each"
    UNRELIABLE = "{protocol} carries no calls: leave it out"
    OTHER_USE = "{may} is for {others}: a {noun} takes {uses}, or leave may out for all"
    NO_MATCH = "{pattern} matches no {noun}: a pattern begins with / or * (/robot1/*)"
    SLASHES = "{pattern} matches no {noun}: names have one / before each part, and none at the end"


class GrantError(ValueError):
    """An operator's text is no entry of `allow` or `deny`."""


def uses(kind: Kind) -> tuple[May, May]:
    """Return the two rights for a kind: to send messages or requests here, and to take them."""
    return TOPIC_USES if kind == "topic" else CALL_USES


def protocols_of(grant: Grant) -> tuple[str, ...]:
    """Return the transports that an entry permits, or none if it permits all."""
    return grant.protocol if isinstance(grant.protocol, tuple) else (grant.protocol,) if grant.protocol else ()


def typed_grants(text: str) -> tuple[str | Grant, ...]:
    """Return the entries in a line: ``/camera/*, {topics: /cmd_vel, may: publish, max_rate: 10}``.

    Raises:
        GrantError: one of them is none.
    """
    entries: list[str | Grant] = []
    for entry in _ENTRY.findall(text):
        if not entry.startswith("{"):
            entries.append(entry)
            continue
        problems: list[Problem] = []
        try:
            entries.append(read(read_yaml(entry, Path()).data, Grant, problems))
        except SessionError as error:
            raise GrantError(f"{show(entry)}: {error.problems[0].message}") from None
        if problems:
            raise GrantError("; ".join(map(str, problems)))
    return tuple(entries)


def allowing(entry: str | Grant) -> Grant:
    """Return an entry of `allow`; a pattern alone is about topics, so that nobody allows services unawares."""
    return Grant(entry) if isinstance(entry, str) else entry


def denying(entry: str | Grant) -> Grant:
    """Return an entry of `deny`; a pattern alone is about topics, services, actions and parameters."""
    return Grant(entry, entry) if isinstance(entry, str) else entry


def grant_problems(holder: Client | Session) -> Iterator[Problem]:
    for key, entries in (("allow", holder.allow), ("deny", holder.deny)):
        for at, grant in enumerate(entries):
            yield from under(join(key, at), _entry_problems(grant, denied=key == "deny"))


def _entry_problems(grant: str | Grant, *, denied: bool) -> Iterator[Problem]:
    if isinstance(grant, str):
        yield from _pattern_problems(grant, "topic", "")
        return
    yield from _subject_problems(grant)
    if grant.protocol == ():
        yield Problem("protocol", RightsMistake.NO_PROTOCOLS())
    if denied and grant.max_rate is not None:
        yield Problem("max_rate", RightsMistake.RATE_OF_DENIED())
    yield from range_problems(grant)


def _subject_problems(grant: Grant) -> Iterator[Problem]:
    """Mistakes in what an entry is about, and in what may be done with that."""
    if grant.topics is None and grant.services is None:
        yield Problem("topics", RightsMistake.NO_PATTERN())
        return
    if grant.topics is not None and grant.services is not None:
        yield Problem("services", RightsMistake.BOTH())
        return
    if grant.topics is not None:
        noun, uses, others = "topic", TOPIC_ENTRIES, "services"
        yield from _pattern_problems(grant.topics, noun, "topics")
    else:
        noun, uses, others = "service", tuple(CALL_USES), "topics"
        yield from _pattern_problems(grant.services or "", noun, "services")
        for protocol in protocols_of(grant):
            if not transports.named(protocol).reliable:
                yield Problem("protocol", RightsMistake.UNRELIABLE(protocol=protocol))
    if grant.may is not None and grant.may not in uses:
        message = RightsMistake.OTHER_USE(may=grant.may, others=others, noun=noun, uses=" or ".join(uses))
        yield Problem("may", message)


def _pattern_problems(pattern: str, noun: str, location: str) -> Iterator[Problem]:
    if not (pattern.startswith(("/", "*")) and pattern.isprintable()):
        yield Problem(location, RightsMistake.NO_MATCH(pattern=show(pattern), noun=noun))
    elif pattern.endswith("/") or "//" in pattern:
        yield Problem(location, RightsMistake.SLASHES(pattern=show(pattern), noun=noun))


def covers(grant: Grant, may: May) -> bool:
    """Whether an entry is about a right: an entry about reading is about looking, too."""
    return grant.may in (None, may) or (may == "look" and grant.may == "read")


def entry_text(grant: Grant) -> str:
    """Return an entry as it is in a session file."""
    plain = msgspec.to_builtins(grant)
    if grant.topics == grant.services or plain.keys() == {"topics"}:  # both: `denying` makes them of a pattern
        return grant.topics or ""
    return inline(plain)
