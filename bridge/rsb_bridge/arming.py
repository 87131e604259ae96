"""Arming topics for consoles, on whatever thread they are: who armed a topic has to keep it armed."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.api import ArmingApi
from rsb_bridge.model.operators import console
from rsb_bridge.route.arming import Disarmed

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine
    from concurrent.futures import Future
    from contextlib import AbstractContextManager

    from rsb_bridge.link.link import Link
    from rsb_bridge.route.route import Route


class BridgeArming:
    """Commands of one bridge, on its event loop; what is wrong with one is an `EngineError`.

    Args:
        links: all of the bridge's.
        find: gives a route and its link by the route's key.
        command: what a command runs in: turns its errors into `EngineError`, and has the snapshot show its effect.
    """

    def __init__(
        self,
        links: Callable[[], list[Link]],
        find: Callable[[str], tuple[Link, Route]],
        command: Callable[[], AbstractContextManager[None]],
    ) -> None:
        self._links = links
        self._find = find
        self._command = command

    async def arm(self, key: str) -> None:
        """Arm a topic for the console that gives the command."""
        with self._command():
            link, route = self._find(key)
            await link.table.arming.arm(route, console())

    async def disarm(self, key: str) -> None:
        """Disarm a topic, even if another operator armed it; return once no earlier message can be published."""
        with self._command():
            link, route = self._find(key)
            link.table.arming.disarm(route, Disarmed.OPERATOR)
            await route.settling.wait()

    async def keep(self, *, pressed: bool) -> None:
        """The console that gives the command is there; `pressed`: its operator has pressed a key."""
        for link in self._links():
            link.table.arming.seen(console(), pressed=pressed)

    async def release(self) -> None:
        """The console that gives the command goes."""
        with self._command():
            for link in self._links():
                link.table.arming.gone(console())

    def reloaded(self) -> None:
        """The session has been read again: whether it still says the same of what is armed is for people to look at."""
        for link in self._links():
            link.table.arming.disarm_all(Disarmed.RELOADED)


Run: TypeAlias = "Callable[[Callable[[BridgeArming], Coroutine[None, None, None]]], Future[None]]"


class EngineArming(ArmingApi):
    """The same from any thread.

    Args:
        run: runs a command on the bridge's thread.
    """

    def __init__(self, run: Run) -> None:
        self._run = run

    def arm(self, key: str) -> Future[None]:
        return self._run(lambda arming: arming.arm(key))

    def disarm(self, key: str) -> Future[None]:
        return self._run(lambda arming: arming.disarm(key))

    def keep(self, *, pressed: bool) -> Future[None]:
        return self._run(lambda arming: arming.keep(pressed=pressed))

    def release(self) -> Future[None]:
        return self._run(lambda arming: arming.release())
