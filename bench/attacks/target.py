"""An attacker's knowledge of its target, and the counts of its actions."""

from __future__ import annotations

import itertools
import time
from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

Tally = Counter[str]
"""What an attacker has done so far, in words."""


class Target(NamedTuple):
    """A server, and the attacker's own key for it.

    Attributes:
        domain: the server's ROS domain.
        secret: the key of the client ``rogue``, in hexadecimal digits; strangers have it too, but use it only to act as
            somebody who recorded that client.
    """

    host: str
    port: int
    domain: int
    secret: str

    @property
    def key(self) -> bytes:
        return bytes.fromhex(self.secret)

    @property
    def address(self) -> tuple[str, int]:
        return self.host, self.port


class Attack(NamedTuple):
    """One of them.

    Attributes:
        run: goes on until its process is ended.
        what: it does, for a reader of the table.
        at_least: least amount to be done by the end; with less, the figures are meaningless.
        protocol: protocol of the legitimate topic that is measured.
        seconds: duration of the attack.
        stage: further nodes that it needs in the server's domain.
    """

    run: Callable[[Target, Tally], None]
    what: str
    at_least: dict[str, int]
    protocol: str = "tcp"
    seconds: float = 6.0
    stage: str = ""


def paced(hz: float) -> Iterator[int]:
    """Count so many times a second; what could not be in time is caught up with."""
    began = time.monotonic()
    for number in itertools.count():
        yield number
        if (ahead := began + (number + 1) / hz - time.monotonic()) > 0.001:
            time.sleep(ahead)
