"""Tells the peer which names of this side's graph match its patterns."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.patterns import NAMES_FOLLOWED, Pattern, is_valid
from rsb_bridge.wire.messages import Followed, FoundName

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from rsb_bridge.context import Context
    from rsb_bridge.link.name_watch import Named, Names
    from rsb_bridge.model.session import Kind
    from rsb_bridge.wire.messages import ControlMessage, Follow, NamePattern

_KINDS: dict[str, Kind] = {kind: kind for kind in LANES}
_IN_ONE_MESSAGE = 200


class FollowedByPeer:
    """What the peer follows of this side's graph, on one link.

    Args:
        context: is told when the peer asks for something else.
        shows: whether the peer may know of a name of a kind.
        send: sends a control message.
    """

    def __init__(
        self, context: Context, shows: Callable[[str, Kind], bool], send: Callable[[ControlMessage], None]
    ) -> None:
        self._context = context
        self._shows = shows
        self._send = send
        self._request: int | None = None  # None: the peer follows nothing
        self._asked_for: tuple[NamePattern, ...] = ()  # not compiled yet
        self._patterns: list[tuple[Kind, Pattern]] = []
        self._told: Names = {}
        self._more = 0
        self._answered = False

    def disconnected(self) -> None:
        """The next connection begins with nothing."""
        self._request, self._asked_for, self._patterns, self._told = None, (), [], {}

    def asked(self, message: Follow) -> None:
        """The peer asks."""
        self.disconnected()
        self._request, self._answered, self._more = message.request, False, 0
        self._asked_for = message.patterns
        self._context.names_changed()

    def patterns_here(self) -> Collection[tuple[Kind, Pattern]]:
        """What the peer asks for. It is compiled when the graph is looked at, not as often as the peer asks."""
        if self._asked_for:
            self._patterns = [
                (kind, Pattern(each.pattern))
                for each in self._asked_for
                if (kind := _KINDS.get(each.kind)) is not None and is_valid(each.pattern)
            ]
            self._asked_for = ()
        return self._patterns

    def look(self, names: Names) -> None:
        """Tell the peer what has changed."""
        if self._request is None or self._asked_for or not (self._patterns or self._told or not self._answered):
            return
        matching = [(named, type_name) for named, type_name in sorted(names.items()) if self._tells(named, type_name)]
        known = [each for each in matching if each[0] in self._told]  # first: a full list does not flutter
        new = [each for each in matching if each[0] not in self._told]
        told = dict(islice((*known, *new), NAMES_FOLLOWED))
        present = [_found(named, kind) for named, kind in told.items() if self._told.get(named) != kind]
        gone = [_found(named, "") for named in self._told if named not in told]
        more = len(matching) - len(told)
        if not (present or gone or more != self._more or not self._answered):
            return
        self._told, self._more, self._answered = told, more, True
        for at in range(0, max(len(present), len(gone), 1), _IN_ONE_MESSAGE):
            part = slice(at, at + _IN_ONE_MESSAGE)
            self._send(Followed(self._request, tuple(present[part]), tuple(gone[part]), more))

    def _tells(self, named: Named, type_name: str) -> bool:
        kind, name = named
        matches = any(kind == each and pattern.match(name) is not None for each, pattern in self._patterns)
        return matches and max(len(name), len(type_name)) <= TEXT_LENGTH and self._shows(name, kind)


def _found(named: Named, type_name: str) -> FoundName:
    kind, name = named
    return FoundName(name, type_name, kind)
