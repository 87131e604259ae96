"""Arming topics through a control socket. The bridge knows a console by its connection, and disarms when that ends."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.api import ArmingApi
from rsb_bridge.control import commands

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from rsb_bridge.control.commands import Command


class RemoteArming(ArmingApi):
    """Arming in an engine of another process.

    Args:
        request: sends a command.
    """

    def __init__(self, request: Callable[[Command], Future[None]]) -> None:
        self._request = request

    def arm(self, key: str) -> Future[None]:
        return self._request(commands.ArmTopic(key))

    def disarm(self, key: str) -> Future[None]:
        return self._request(commands.DisarmTopic(key))

    def keep(self, *, pressed: bool) -> Future[None]:
        return self._request(commands.KeepArmed(pressed))

    def release(self) -> Future[None]:
        return self._request(commands.ReleaseArmed())
