"""The ways from a client to its server: the addresses that its session lists, of which one carries the link.

While the link is up, the others are tried now and then by a TCP connection that ends at once. It costs some 400 bytes:
a better way has that every few seconds while it is not in use, a worse one, which may be paid for, once a minute.
"""

from __future__ import annotations

import asyncio
from math import inf
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.snapshot import WaySnapshot
from rsb_bridge.route.arming import HELD
from rsb_bridge.transport.network_news import device_of
from rsb_bridge.transport.streams import StreamHandler

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Sequence

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.connecting import Failure

_NEXT_AFTER = 0.25  # s until the next host is tried, too, as with the addresses of one (`transport.tcp`)
HELD_FOR = 10.0  # s for which a better way answers before the link moves there
_BETTER_EVERY, _WORSE_EVERY = 2.5, 60.0  # s between two tries of a way. Round figures


class _Tried(NamedTuple):
    """The tries of a way that is not in use."""

    due: float = -inf  # time of the next try
    ready_since: float | None = None  # or None if the last try failed


class ServerWays:
    """The ways of one client.

    Attributes:
        used: index of the host that the present or the last connection reached.
    """

    def __init__(self, link: BaseLink, hosts: Sequence[str]) -> None:
        self.hosts = tuple(hosts)
        self.used = 0
        self._link = link
        self._tried: dict[str, _Tried] = {}
        self._trying: set[str] = set()
        self._devices: dict[str, str] = {}

    def next_hosts(self) -> Sequence[str]:
        """Return the hosts in the order in which to try them: a doubted one comes last."""
        if not self._link.linked:
            return self.hosts
        return *(host for host in self.hosts if host != self.hosts[self.used]), self.hosts[self.used]

    def take(self, host: str) -> None:
        """Note that the link has a connection to this host now."""
        self.used = self.hosts.index(host)
        self._tried.clear()
        self._devices.clear()

    def failed(self, host: str) -> None:
        """Note that the link could not move to a host, which has to hold for as long again."""
        self._tried.pop(host, None)

    def changed(self) -> None:
        """Try all of them soon: this machine's network has changed."""
        self._devices.clear()
        self._tried = {host: each._replace(due=-inf) for host, each in self._tried.items()}

    def tick(self) -> str | None:
        """Try what is due, once a second while the link is up; return the host to which it is to move, or None."""
        now, better = self._link.context.now(), self._better()
        for host in (*better, *self.hosts[self.used + 1 :]):
            tried = self._tried.get(host, _Tried())
            if now >= tried.due and host not in self._trying:
                self._trying.add(host)
                self._link.spawn(self._try(host, _BETTER_EVERY if host in better else _WORSE_EVERY))
        since = ((host, self._tried.get(host, _Tried()).ready_since) for host in better)
        found = next((host for host, time in since if time is not None and now - time >= HELD_FOR), None)
        # A move disarms, and an operator who drives sees no reason for that.
        if found is None or any(route.arming.phase in HELD for route in self._link.awake):
            return None
        return found

    def _better(self) -> Sequence[str]:
        """Return the hosts before the one in use, and that one if a new connection to it leaves from elsewhere."""
        link = self._link
        assert link.control is not None
        stream, used = link.control.stream, self.hosts[self.used]
        moved = link.transport.source_address(stream.host) not in ("", stream.own_address)
        return *self.hosts[: self.used], *((used,) if moved else ())

    async def _try(self, host: str, every: float) -> None:
        link, now = self._link, self._link.context.now()
        since = self._tried.get(host, _Tried()).ready_since
        try:
            stream = await link.transport.connect(host, link.shared_port(), StreamHandler())
        except OSError:
            since = None
        else:
            stream.abort("only tried")
            since = now if since is None else since
        finally:
            self._trying.discard(host)
        self._tried[host] = _Tried(now + every, since)

    # --- what operators see

    def snapshots(self) -> tuple[WaySnapshot, ...]:
        """Return all ways in their order, or nothing if there is only one."""
        if len(self.hosts) == 1:
            return ()
        used = self.used if self._link.linked else None
        return tuple(
            WaySnapshot(host, self._device(host), is_used=at == used, is_ready=self._is_ready(host))
            for at, host in enumerate(self.hosts)
        )

    def _is_ready(self, host: str) -> bool:
        return self._tried.get(host, _Tried()).ready_since is not None

    def _device(self, host: str) -> str:
        if host not in self._devices:
            self._devices[host] = device_of(self._link.transport.source_address(host))
        return self._devices[host]


async def first_of(
    hosts: Sequence[str], connect: Callable[[str], Coroutine[None, None, Failure | None]]
) -> Failure | None:
    """Connect to the hosts, begun one after the other, until one accepts the link; return the failure if none does."""
    waiting, failures = list(hosts), []
    tasks: set[asyncio.Task[Failure | None]] = set()
    try:
        while waiting or tasks:
            if waiting:
                tasks.add(asyncio.create_task(connect(waiting.pop(0))))
            within = _NEXT_AFTER if waiting else None
            done, tasks = await asyncio.wait(tasks, timeout=within, return_when=asyncio.FIRST_COMPLETED)
            for each in done:
                if (failure := each.result()) is None:
                    return None
                failures.append(failure)
    finally:
        for each in tasks:
            each.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    failures.sort(key=lambda each: each.reason)  # else the same fault would read as a new one, whichever came first
    telling = next((each for each in failures if each.refused), failures[0])
    return telling._replace(reason="; ".join(dict.fromkeys(each.reason for each in failures)))
