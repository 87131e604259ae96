"""Watches which way of a machine carries a link whose streams may use several (`rsb_bridge.transport.multipath`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.link.extension import Extension
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.transport.network_news import device_of

if TYPE_CHECKING:
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.transport.multipath import Subflow


_IN_USE = 2.0  # s since data went that way: there is a ping each second


class Subflows(Extension):
    """Logs when another way of one connection carries a link.

    Attributes:
        text: the way that carries, and the others, for operators: ``wlan0 (lte0 ready)``; empty if there is only one.
    """

    def __init__(self, link: BaseLink) -> None:
        self.text = ""
        self._used: tuple[str, str] | None = None  # both ends of the way that carries
        self._link = link

    def _forget(self) -> None:
        self.text, self._used = "", None

    disconnected = away = _forget

    def tick(self) -> None:
        control = self._link.control
        ways = () if control is None else control.stream.subflows()
        if len(ways) < 2:
            self._forget()
            return
        in_use = [way for way in ways if way.answers and way.sent_ago < _IN_USE]
        used = next((way for way in in_use if way[:2] == self._used), None)
        if used is None:
            used = min(ways, key=lambda way: (not way.answers, way.sent_ago))
        self._used = used[:2]
        others = [f"{self._name(way)} {'ready' if way.answers else 'silent'}" for way in ways if way is not used]
        text = f"{self._name(used)} ({', '.join(others)})"
        if text != self.text:
            self.text = text
            self._link.log_of_peer(Level.INFO, EventCode.LINK_WAY, f"carried via {text}", link_status=True)

    def _name(self, way: Subflow) -> str:
        """Return the device of a way; a server, whose ways often have one, names the client's address."""
        return (device_of(way.own) or way.own) if self._link.is_client else way.peer
