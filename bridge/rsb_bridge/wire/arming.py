"""The control messages by which routes are armed and disarmed (PROTOCOL.md, 7)."""

from __future__ import annotations

from typing import TypeAlias

from rsb_bridge.model.limits import DEADMAN_TIME
from rsb_bridge.wire.fields import Name, RouteId  # noqa: TC001 - msgspec resolves the annotations at run time
from rsb_bridge.wire.message import ControlMessageBase


def check_deadman(seconds: float) -> None:
    """Raise ValueError where a deadman time is out of range."""
    if seconds and seconds not in DEADMAN_TIME:
        raise ValueError(f"deadman is 0 or {DEADMAN_TIME} s")


class Arm(ControlMessageBase, frozen=True):
    """Either side: an operator arms the route, which the other side answers by `Armed`.

    Sent again, once a second at most, when that operator has pressed a key.

    Attributes:
        route: route id. Under one id a route is armed once.
        who: the operator, in words.
    """

    route: RouteId
    who: Name = ""


class Armed(ControlMessageBase, frozen=True):
    """The answer to `Arm`: both sides hold the route for armed from here on.

    Attributes:
        route: route id.
    """

    route: RouteId


class Disarm(ControlMessageBase, frozen=True):
    """Either side: the route is not armed any more, or cannot be armed under this id. Its proposer opens it anew.

    Attributes:
        route: route id.
        cause: why, a stable name.
        who: the operator who did it, in words; empty: it came by itself.
    """

    route: RouteId
    cause: Name
    who: Name = ""


ArmingMessage: TypeAlias = Arm | Armed | Disarm
