"""The thesis's ``/shutdown`` topic: ``std_msgs/String`` "shutdown" closes the sockets on both sides."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.known_messages import STRING, STRING_HASH, string_bytes
from rsb_bridge.ros.lasting_subscription import LastingSubscription

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.ros_interface import OnFailure, RawMessage, RosInterface, Subscription

_WORD = b"shutdown"


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
        if any(string_bytes(taken.payload) == _WORD for taken in batch):
            act()

    def subscribe(on_failure: OnFailure) -> Subscription:
        type_hash = ros.installed_hash(STRING) or STRING_HASH
        return ros.subscribe(topic, STRING, type_hash, Qos(), sink, None, on_failure)

    def changed() -> None:
        if watch.failure:
            failed(watch.failure)

    watch = LastingSubscription(loop, subscribe, changed)
    return watch
