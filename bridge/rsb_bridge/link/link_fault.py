"""A link's fault, up or down: one cause, in words for an operator."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.link.connecting import unproven_servers
from rsb_bridge.link.extension import Extension
from rsb_bridge.link.refused_clients import DuplicateClients
from rsb_bridge.model.verdict import LinkCause, clocks_differ

if TYPE_CHECKING:
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.fullness import LinkFullness
    from rsb_bridge.link.path_watch import PathWatch


class PresentFault(NamedTuple):
    cause: LinkCause  # of a link that is up or down
    warning: str  # what is wrong with one that is up, for an operator, or an empty string
    warning_since: float | None  # s since the epoch, or None without a warning


class LinkFault(Extension):
    """The fault of one link, up or down.

    Attributes:
        duplicates: refused clients that have the link's name, too.
        unproven: number of servers that were announced when the link was made, and did not prove the key.
    """

    def __init__(self, link: BaseLink, path: PathWatch, fullness: LinkFullness) -> None:
        self.duplicates = DuplicateClients(link.name)
        self.unproven = 0
        self._link, self._path, self._fullness = link, path, fullness
        self._warned: tuple[LinkCause, float] = (LinkCause.NONE, 0.0)

    def disconnected(self) -> None:
        self.duplicates = DuplicateClients(self.duplicates.name)  # without a link, nobody has the name
        self._warned = LinkCause.NONE, 0.0  # a link that is up again before the next tick is another one

    suspend = disconnected

    def tick(self) -> None:
        self.now()  # a warning begins now, even if no console asks for a snapshot

    def _found(self) -> list[tuple[LinkCause, str]]:
        """Return what is wrong with a link that is up, in words for an operator, the worst first."""
        link, path = self._link, self._path.fault
        if link.status.cause is not LinkCause.NONE:
            return []
        found = (
            # Before a second machine of the name, which operators acknowledge for weeks: topics suffer from the path.
            (path.cause, path.text) if path else (LinkCause.NONE, ""),
            (LinkCause.NAME_TAKEN, self.duplicates.text(link.context.now(), link.context.wall())),
            # A path that loses packets carries less, too: its loss explains that.
            (LinkCause.FULL, "" if path else self._fullness.warning),
            (LinkCause.UNPROVEN_SERVERS, unproven_servers(self.unproven) if self.unproven else ""),
            (LinkCause.CLOCKS_DIFFER, clocks_differ(link.peer_name, link.clock.offset, link.clock.uncertainty)),
        )
        return [each for each in found if each[1]]

    def cause(self) -> LinkCause:
        """Return the cause of the link's fault, up or down."""
        return next((cause for cause, _ in self._found()), self._link.status.cause)

    def now(self) -> PresentFault:
        """Return the fault as it is now. Called once a second, so that the beginning of a warning is known."""
        found = self._found()
        cause = found[0][0] if found else LinkCause.NONE
        if cause != self._warned[0]:
            self._warned = cause, self._link.context.clock.steady()
        since = self._link.context.wall_of(self._warned[1]) if cause else None
        return PresentFault(cause or self._link.status.cause, "; ".join([text for _, text in found]), since)
