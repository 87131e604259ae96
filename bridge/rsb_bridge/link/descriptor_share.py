"""How many of a server's descriptors one client's topics may hold: never more than are left for everyone else."""

from __future__ import annotations

import resource
from typing import TYPE_CHECKING

from rsb_bridge.transport import descriptors

if TYPE_CHECKING:
    from collections.abc import Callable


class DescriptorShare:
    """The streams and the ports of its own that one client's topics have on the server.

    With the rule, one client alone may take half of what there is; of any number that take all they can, none keeps
    the next one out. It needs no figure, and so fits whatever limit the process has.
    """

    def __init__(self, client: str, is_only_client: Callable[[], bool]) -> None:
        """There are none yet.

        Args:
            client: its name.
            is_only_client: whether there is nobody else to leave any for.
        """
        self.held = 0
        self._client = client
        self._is_only_client = is_only_client

    @property
    def room(self) -> int:
        """How many more it may have now."""
        left = descriptors.left()
        return left if self._is_only_client() else (left - self.held + 1) // 2

    @property
    def refusal(self) -> str:
        """Why it may have no more now, for the operators of both sides; empty: it may."""
        if descriptors.scarce():
            return descriptors.scarcity_message("server")
        if self.room > 0:
            return ""
        limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        return (
            f"{self._client}'s topics may hold no more of the server's {limit:,} file descriptors than are left for "
            f"everyone else: {descriptors.MORE_DESCRIPTORS} there, or use protocol: udp, whose topics share one"
        )

    def take(self) -> Callable[[], None]:
        """Count one more.

        Returns:
            What to call once when it is closed.
        """
        self.held += 1
        return self._give

    def _give(self) -> None:
        self.held -= 1
