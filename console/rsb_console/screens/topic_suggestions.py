"""Suggestions of what can be bridged, from the graphs of both sides."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from rich.cells import cell_len

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.text import plural
from rsb_console.notation.formats import KIND_NOUN
from rsb_console.notation.glyphs import IN, OUT
from rsb_console.widgets.lines import Line, fit_middle
from rsb_console.widgets.picker import Suggestion

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.model.session import Kind
    from rsb_bridge.model.snapshot import RouteSnapshot, TopicInfo
    from rsb_console.session.draft import Ends

_NAME_WIDTH, _WHERE_WIDTH, _TYPE_WIDTH = 32, 21, 25
"""Cells: names get what the others leave, at least so many, if the longest one needs that; types get the rest."""
_ENDS: dict[Kind, tuple[str, str]] = {
    "topic": ("publisher", "subscriber"),
    "service": ("server", "client"),
    "action": ("server", "client"),
    "parameters": ("parameters", "client"),
}
"""The endpoints of each kind on the providing side, and on the other."""


def suggestions_for(
    ends: Ends, here: Iterable[TopicInfo], there: Iterable[TopicInfo], bridged: Sequence[RouteSnapshot]
) -> list[Suggestion]:
    """Return what can be bridged from both graphs: topics, then services, actions and parameters, each by name.

    A publisher makes a topic flow away from its side; where there are only subscriptions it is to flow towards them.
    If a name has both, one on each side, the publisher decides. So it is with the servers and clients of a service.

    Args:
        bridged: the link's routes; neither end of one is offered the same way again, nor its services.
    """
    taken = {route.spec.identity for route in bridged}
    crossing = set()
    for route in bridged:
        from_here = route.outgoing and route.spec.kind == "topic"  # the names of calls cross one way only
        services = [lane.suffix for lane in LANES[route.spec.kind] if lane.suffix and not lane.is_topic]
        for name, is_here in ((route.topic, True), (route.remote_topic, False)):
            crossing.add((route.spec.kind, is_here, name, from_here))
            crossing |= {("service", is_here, f"{name}{suffix}", from_here) for suffix in services}
    infos = [(info, is_here) for graph, is_here in ((here, True), (there, False)) for info in graph]
    longest = max((cell_len(info.topic) for info, _ in infos), default=0)
    suggestions: dict[str, Suggestion] = {}
    # Publishers first, as the first suggestion of a key stays.
    for info, is_here in sorted(infos, key=lambda each: not each[0].publishers):
        suggestion = _suggestion(ends, info, is_here, longest)
        from_here = info.kind == "topic" and is_here == bool(info.publishers)
        if (
            suggestion is not None
            and (info.kind, is_here, info.topic, from_here) not in crossing
            and (info.kind, suggestion.value, _direction(ends, info, is_here)) not in taken
        ):
            suggestions.setdefault(suggestion.key, suggestion)
    order = {str(kind): number for number, kind in enumerate(KIND_NOUN)}
    return sorted(suggestions.values(), key=lambda each: (order[each.fills["kind"]], each.value))


def _direction(ends: Ends, info: TopicInfo, is_here: bool) -> str:
    """Messages go away from publishers, and requests towards servers."""
    gives = (is_here == ends.is_server) == bool(info.publishers)
    return "receive" if gives == (info.kind == "topic") else "transmit"


def _suggestion(ends: Ends, info: TopicInfo, is_here: bool, longest: int) -> Suggestion | None:
    """Make the suggestion with the client's name, or return None if the client has none."""
    name = ends.client_topic(info.topic, on_server=is_here == ends.is_server)
    if name is None:
        return None
    direction = _direction(ends, info, is_here)
    fills = {
        "kind": info.kind,
        "direction": direction,
        "provider": "server" if direction == "transmit" else "client",
        "type": AUTO if info.kind == "parameters" else info.type_name or AUTO,
    }
    return Suggestion(f"{info.kind} {direction} {name}", name, partial(_line, info, is_here, longest), fills)


def _line(info: TopicInfo, is_here: bool, longest: int, width: int) -> Line:
    room = width - 2 - _WHERE_WIDTH
    name_width = min(longest + 1, max(_NAME_WIDTH, room - _TYPE_WIDTH))
    gives, takes = _ENDS[info.kind]
    count, what = (info.publishers, gives) if info.publishers else (info.subscriptions, takes)
    amount = gives if info.kind == "parameters" and info.publishers else f"{count} {plural(count, what)}"
    outwards = (is_here == bool(info.publishers)) == (info.kind == "topic")
    type_name = "" if info.kind == "parameters" else info.type_name.replace("/msg/", "/") or "several types"
    return (
        (f"{OUT if outwards else IN} ", ""),
        *padded(info.topic, name_width, "strong"),
        *padded(f"{amount} {'here' if is_here else 'there'}", _WHERE_WIDTH, "dim"),
        (fit_middle(type_name, max(1, room - name_width)), ""),
    )


def padded(text: str, width: int, look: str) -> Line:
    cut = fit_middle(text, width - 1)
    return (cut, look), (" " * (width - cell_len(cut)), "")
