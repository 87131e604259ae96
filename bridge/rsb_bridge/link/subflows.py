"""Watches which way of a machine carries a link whose streams may use several (`rsb_bridge.transport.multipath`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.link.extension import Extension
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, WaySnapshot
from rsb_bridge.transport.network_news import device_of

if TYPE_CHECKING:
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.transport.multipath import Subflow


_IN_USE = 2.0  # s since data went that way: there is a ping each second


class Subflows(Extension):
    """Logs when another way of one connection carries a link.

    Attributes:
        ways: the ways, or nothing if there has only been one.
    """

    def __init__(self, link: BaseLink) -> None:
        self.ways: tuple[WaySnapshot, ...] = ()
        self._used: tuple[str, str] | None = None  # both ends of the way that carries
        self._link = link

    @property
    def used(self) -> str:
        """The name of the way that carries, or an empty string if there is only one."""
        return next((_name(way) for way in self.ways if way.is_used), "")

    def _forget(self) -> None:
        self.ways, self._used = (), None

    disconnected = suspend = _forget

    def tick(self) -> None:
        control = self._link.control
        ways = () if control is None else control.stream.subflows()
        if control is None or not ways:
            self._forget()
            return
        in_use = [way for way in ways if way.answers and way.sent_ago < _IN_USE]
        used = next((way for way in in_use if way[:2] == self._used), None)
        if used is None:
            used = min(ways, key=lambda way: (not way.answers, way.sent_ago))
        self._used = used[:2]
        # The kernel gives up a way that is silent for long, and never opens the first one again. A client whose link is
        # elsewhere than a new connection would be moves back (`server_ways`).
        control.stream.own_address = used.own
        shown = tuple(self._shown(way, is_used=way is used) for way in ways)
        if shown != self.ways and (len(shown) > 1 or self.ways):
            self.ways = shown
            others = [f"{_name(way)} {'ready' if way.is_ready else 'not ready'}" for way in shown if not way.is_used]
            text = f"carried via {self.used} ({', '.join(others) or 'no other way'})"
            self._link.log_of_peer(Level.INFO, EventCode.LINK_WAY, text, link_status=True)

    def _shown(self, way: Subflow, *, is_used: bool) -> WaySnapshot:
        """Return a way as operators see it: on a server, whose ways mostly have one device, by the client's address."""
        host, device = (way.own, device_of(way.own)) if self._link.is_client else (way.peer, "")
        return WaySnapshot(host, device, is_used=is_used, is_ready=way.answers)


def _name(way: WaySnapshot) -> str:
    return way.device or way.host
