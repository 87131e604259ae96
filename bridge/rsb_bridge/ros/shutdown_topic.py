"""The thesis's ``/shutdown`` topic: ``std_msgs/String`` "shutdown" closes the sockets on both sides."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from rsb_bridge.model.qos import Qos

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.api import RawMessage, RosInterface, Subscription

_TYPE = "std_msgs/msg/String"
_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
_WORD = "shutdown"


def watch_shutdown_topic(ros: RosInterface, topic: str, act: Callable[[], None]) -> Subscription:
    """Call `act` on the ROS thread whenever somebody publishes the word.

    Raises:
        RosError: the topic can't be subscribed to.
    """

    def sink(batch: Sequence[RawMessage]) -> None:
        if any(string_of(taken.payload) == _WORD for taken in batch):
            act()

    return ros.subscribe(topic, _TYPE, ros.installed_hash(_TYPE) or _HASH, Qos(), sink, origin=None)


def string_of(payload: bytes) -> str | None:
    """The ``data`` of a serialized ``std_msgs/String`` (CDR: OMG DDSI-RTPS 2.3, 10.5); None: it is none."""
    try:
        (length,) = struct.unpack_from("<I" if payload[1] & 1 else ">I", payload, 4)
        return payload[8 : 8 + length - 1].decode()
    except (struct.error, IndexError, UnicodeDecodeError):
        return None
