"""Patterns as user interfaces show them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.patterns import EXCEPTIONS_PER_PATTERN, FEATURE, ROUTES_BY_PATTERNS, ROUTES_PER_PATTERN
from rsb_bridge.model.snapshot import PatternSnapshot, State

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.link.pattern_entry import PatternEntry
    from rsb_bridge.link.patterns import LinkPatterns


def snapshots_of(patterns: LinkPatterns) -> Iterator[PatternSnapshot]:
    """Those of one link, as they are now."""
    for entry in patterns.entries:
        routes = patterns.routes_of(entry)
        gone = sum(1 for each in routes if each.spec.identity in patterns.gone)
        count = f"{len(routes)} bridged{f', {gone} of them gone' if gone else ''}"
        state, reason = _state(patterns, entry, count if routes else "")
        here = patterns.is_local(entry)
        yield PatternSnapshot(
            key=patterns.key_of(entry.topic),
            link=patterns.link.name,
            spec=entry.topic,
            state=state,
            reason=reason,
            here=here,
            source=entry.source.text,
            routes=len(routes),
            gone=gone,
            beyond=entry.beyond + (0 if here else patterns.unseen),
        )


def _state(patterns: LinkPatterns, entry: PatternEntry, count: str) -> tuple[State, str]:
    link, here = patterns.link, patterns.is_local(entry)
    some = f"{count}; " if count else ""
    if entry.beyond:
        return State.DOWN, f"{some}{limit_reached(entry, len(patterns.routes_of(entry)))}"
    if entry.left_out:
        name, reason = next(iter(entry.left_out.items()))
        return State.DOWN, f"{some}{len(entry.left_out)} not bridged: {name}: {reason}"
    if entry.topic.paused:
        return State.PAUSED, count
    if not here and patterns.unseen:
        return State.DOWN, f"{some}the other side does not tell {patterns.unseen} more that match: narrow the patterns"
    if not here and link.linked and FEATURE not in link.features:
        return State.DOWN, f"{some}the other side cannot tell what matches: update rsb-console there"
    if not here and patterns.there is None:
        why = "it has just been asked" if link.linked else f"not linked: {link.down_reason or 'not connected yet'}"
        return State.WAITING, f"{some}what the other side has is not known: {why}"
    if not count:
        side = f"in domain {link.context.domain_id}" if here else "on the other side"
        but = ", but for what it leaves out" if entry.topic.excepts else ""
        return State.WAITING, f"nothing {side} matches {entry.source.text}{but}"
    return State.OK, count


def exceptions_reached(entry: PatternEntry) -> str:
    """Why a pattern can leave out no more names, and what to do; empty: it can."""
    if len(entry.topic.excepts) < EXCEPTIONS_PER_PATTERN:
        return ""
    limit = f"pattern {entry.topic.topic} has {EXCEPTIONS_PER_PATTERN} exceptions already, which is the limit"
    return f"{limit}: edit it, and use patterns in except"


def limit_reached(entry: PatternEntry, routes: int) -> str:
    """What is left out for a limit, and what to do."""
    alone = routes >= ROUTES_PER_PATTERN
    limit = f"{ROUTES_PER_PATTERN} for a pattern" if alone else f"{ROUTES_BY_PATTERNS} for all patterns of a link"
    remedy = "make it narrower, leave some out (except), or list them by name"
    return f"{entry.beyond} more match, and are not bridged: the limit is {limit}; {remedy}"
