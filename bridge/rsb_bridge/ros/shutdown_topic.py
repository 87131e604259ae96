"""The thesis's ``/shutdown`` topic: ``std_msgs/String`` "shutdown" closes the sockets on both sides."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.lasting_subscription import LastingSubscription

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.api import OnFailure, RawMessage, RosInterface, Subscription

_TYPE = "std_msgs/msg/String"
_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
_WORD = "shutdown"


def watch_shutdown_topic(
    ros: RosInterface,
    loop: asyncio.AbstractEventLoop,
    topic: str,
    act: Callable[[], None],
    failed: Callable[[str], None],
) -> LastingSubscription:
    """Wait for somebody to publish the word.

    Args:
        ros: where.
        loop: the I/O loop.
        topic: its name.
        act: called on the ROS thread each time.
        failed: called on the loop with the reason when the subscription fails; it is opened anew.

    Raises:
        RosError: the topic can't be subscribed to.
    """

    def sink(batch: Sequence[RawMessage]) -> None:
        if any(string_of(taken.payload) == _WORD for taken in batch):
            act()

    def subscribe(on_failure: OnFailure) -> Subscription:
        type_hash = ros.installed_hash(_TYPE) or _HASH
        return ros.subscribe(topic, _TYPE, type_hash, Qos(), sink, None, on_failure)

    def changed() -> None:
        if watch.failure:
            failed(watch.failure)

    watch = LastingSubscription(loop, subscribe, changed)
    return watch


def string_of(payload: bytes) -> str | None:
    """The ``data`` of a serialized ``std_msgs/String`` (CDR: OMG DDSI-RTPS 2.3, 10.5); None: it is none."""
    try:
        (length,) = struct.unpack_from("<I" if payload[1] & 1 else ">I", payload, 4)
        return payload[8 : 8 + length - 1].decode()
    except (struct.error, IndexError, UnicodeDecodeError):
        return None
