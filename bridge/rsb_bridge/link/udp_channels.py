"""The UDP channels of one link."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level
from rsb_bridge.transport.transport import RECEIVE_BUFFER

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

    from rsb_bridge.channel.udp_channel import BufferShortage, UdpChannel

_PROBE_EVERY, _QUICK_PROBES = 0.25, 8


class UdpChannels:
    """A link's UDP channels by port, probed and watched as long as they are open.

    Args:
        loop: sets the timers.
        log: adds an event about the link.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, log: Callable[[Level, EventCode, str], None]) -> None:
        self._loop = loop
        self._log = log
        self._channels: dict[int, UdpChannel] = {}
        self._shortages_told: set[bool] = set()

    def get(self, port: int) -> UdpChannel | None:
        """The open channel of a port."""
        channel = self._channels.get(port)
        return channel if channel is not None and not channel.over else None

    def add(self, port: int, channel: UdpChannel) -> None:
        """Add a new channel."""
        self._channels[port] = channel

    def open(self, port: int, channel: UdpChannel) -> None:
        """Add a new channel, and probe its path."""
        self.add(port, channel)
        self._probe(channel)

    def _probe(self, channel: UdpChannel, probes: int = 1) -> None:
        """Probe a new channel every 0.25 s; after 8 probes without an answer, `tick` alone goes on once a second."""
        if probes <= _QUICK_PROBES and not channel.ready and not channel.over:
            channel.tick()
            self._loop.call_later(_PROBE_EVERY, self._probe, channel, probes + 1)

    def tick(self) -> None:
        """Once a second: probe, and say when nothing gets through any more, or again, or a kernel's buffer is small."""
        self._channels = {port: channel for port, channel in self._channels.items() if not channel.over}
        for channel in self._channels.values():
            before = channel.trouble
            channel.tick()
            if channel.trouble and not before:
                self._log(Level.WARNING, EventCode.LINK_UDP_BLOCKED, channel.trouble)
            elif before and not channel.trouble:
                self._log(Level.INFO, EventCode.LINK_UDP_RESTORED, "UDP gets through again")
            for here, shortage in channel.shortages.items():
                if here not in self._shortages_told:
                    self._shortages_told.add(here)
                    self._log(Level.WARNING, EventCode.LINK_UDP_BUFFER, shortage_message(shortage))

    def close(self) -> None:
        """Close them all."""
        for channel in self._channels.values():
            channel.close()
        self._channels.clear()

    def all(self) -> list[UdpChannel]:
        """All channels."""
        return list(self._channels.values())


def shortage_message(shortage: BufferShortage) -> str:
    """What holds large messages up, and the remedy; for the operator of either side."""
    whose, where = ("this machine's", "here") if shortage.here else ("the other side's", "there")
    return (
        f"{whose} kernel keeps only {shortage.granted:,} bytes of UDP, and messages have {shortage.message:,}: they "
        f"are slow, or lost. Run {where}: sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER}"
    )
