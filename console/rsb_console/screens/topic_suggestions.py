"""The topics of both graphs that are not bridged yet, as suggestions for the topic form."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from rich.cells import cell_len

from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.text import plural
from rsb_console.look.glyphs import IN, OUT
from rsb_console.widgets.lines import Line, fit_middle
from rsb_console.widgets.picker import Suggestion

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.model.snapshot import RouteSnapshot, TopicInfo
    from rsb_console.session.draft import Ends

_NAME_WIDTH, _WHERE_WIDTH, _TYPE_WIDTH = 32, 21, 24  # cells; the name takes what is left, and no less than this


def suggestions_for(
    ends: Ends, here: Iterable[TopicInfo], there: Iterable[TopicInfo], bridged: Sequence[RouteSnapshot]
) -> list[Suggestion]:
    """What both graphs have that is not bridged yet, by name.

    A publisher makes a topic flow away from its side; where there are only subscriptions it is to flow towards them.
    What has both, one on each side, is told by its publisher.

    Args:
        ends: of the link.
        here: this side's graph.
        there: the other side's.
        bridged: the link's routes; neither end of one is offered the same way again.
    """
    taken = {(route.spec.topic, route.spec.direction) for route in bridged}
    crossing = {
        (is_here, route.topic if is_here else route.remote_topic, route.outgoing)
        for route in bridged
        for is_here in (True, False)
    }
    infos = [(info, is_here) for graph, is_here in ((here, True), (there, False)) for info in graph]
    suggestions: dict[str, Suggestion] = {}
    for info, is_here in sorted(infos, key=lambda each: not each[0].publishers):
        suggestion = _suggestion(ends, info, is_here)
        if (
            suggestion is not None
            and (is_here, info.topic, is_here == bool(info.publishers)) not in crossing
            and (suggestion.value, suggestion.fills["direction"]) not in taken
        ):
            suggestions.setdefault(suggestion.key, suggestion)
    return sorted(suggestions.values(), key=lambda suggestion: suggestion.value)


def _suggestion(ends: Ends, info: TopicInfo, is_here: bool) -> Suggestion | None:
    """What the client would call it; None: it is not the client's to bridge."""
    on_server = is_here == ends.is_server
    name = ends.client_topic(info.topic, on_server=on_server)
    if name is None:
        return None
    fills = {
        "direction": "receive" if on_server == bool(info.publishers) else "transmit",
        "type": info.type_name or AUTO,
    }
    return Suggestion(f"{fills['direction']} {name}", name, partial(_line, info, is_here), fills)


def _line(info: TopicInfo, is_here: bool, width: int) -> Line:
    name_width = max(_NAME_WIDTH, width - 2 - _WHERE_WIDTH - _TYPE_WIDTH)
    count, what = (info.publishers, "publisher") if info.publishers else (info.subscriptions, "subscriber")
    return (
        (f"{OUT if is_here == bool(info.publishers) else IN} ", ""),
        *_column(info.topic, name_width, "strong"),
        *_column(f"{count} {plural(count, what)} {'here' if is_here else 'there'}", _WHERE_WIDTH, "dim"),
        (info.type_name.replace("/msg/", "/") or "several types", ""),
    )


def _column(text: str, width: int, look: str) -> Line:
    cut = fit_middle(text, width - 1)
    return (cut, look), (" " * (width - cell_len(cut)), "")
