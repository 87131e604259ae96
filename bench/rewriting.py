"""Prints what a frame prefix and stamps of this machine cost a message: ``python -m bench.rewriting``.

Off, a message is only checked, as each one is. The four ways take turns, in µs of CPU time of this thread.
"""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING

from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image

from rsb_bridge.cdr.checker import Checker
from rsb_bridge.cdr.description import (
    FieldType,
    MessageField,
    MessageType,
    TypeDescription,
    hash_of_text,
    read_description,
)
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_bridge.route.message_transform import MessageTransform, changed
from rsb_extras.demo.robot_frames import Frame, serialized
from rsb_extras.frames.message_rewriter import Rewriter, compile_plan

if TYPE_CHECKING:
    from collections.abc import Callable

_ROUNDS = 31
_ROUND = 0.02  # s of messages in a round, about
_SEQUENCE_OF_NESTED = 145
_ONE = "geometry_msgs/msg/TransformStamped"


class _Prefix(MessageTransform):
    def __init__(self, rewriter: Rewriter) -> None:
        self._rewriter = rewriter

    def change(self, content: bytes) -> bytes:
        return self._rewriter.rewrite(content)


def main() -> None:
    row = "{:<28} {:>10} {:>8} {:>10} {:>10} {:>8}".format
    print(row("", "bytes", "off, µs", "prefix", "restamp", "both"))
    frames = serialized([Frame("odom", f"link_{n}", n) for n in range(50)], time.time_ns())
    image = Image(encoding="rgb8", height=1500, width=1334, step=4002, data=bytes(6_003_000))
    image.header.frame_id = "camera"
    image.header.stamp.sec = int(time.time())
    for name, payload, description in (
        ("TF of 50 transforms", frames, _frames()),
        ("Image of 6 MB", bytes(serialize_message(image)), _described("sensor_msgs/msg/Image")),
    ):
        print(row(name, f"{len(payload):,}", *(f"{each:.1f}" for each in _measure(payload, description))))


def _measure(payload: bytes, description: TypeDescription) -> list[float]:
    checker = Checker(description)

    def way(*, prefix: str, shift: int) -> Callable[[], object]:
        transforms: tuple[MessageTransform, ...] = ()
        if prefix or shift:
            plan = compile_plan(description, frames=bool(prefix), stamps=bool(shift))
            assert plan is not None
            rewriter = Rewriter(plan, prefix)
            rewriter.shift = shift
            transforms = (_Prefix(rewriter),)

        def work() -> bytes:
            checker.check(payload)
            return changed(payload, transforms) if transforms else payload

        return work

    ways = [way(prefix=prefix, shift=shift) for prefix, shift in (("", 0), ("robot1/", 0), ("", 7), ("robot1/", 7))]
    counts = [max(5, int(_ROUND / (_cost(each, 20) / 1e6))) for each in ways]
    rounds = [[_cost(each, count) for each, count in zip(ways, counts, strict=True)] for _ in range(_ROUNDS)]
    return [statistics.median(figures) for figures in zip(*rounds, strict=True)]


def _cost(work: Callable[[], object], count: int) -> float:
    """Return µs of one call."""
    began = time.thread_time()
    for _ in range(count):
        work()
    return (time.thread_time() - began) / count * 1e6


def _described(name: str) -> TypeDescription:
    return read_description(text := installed_description(name) or "", hash_of_text(text))


def _frames() -> TypeDescription:
    """Return the description of TFMessage, which no wheel has."""
    one = _described(_ONE)
    field = MessageField("transforms", FieldType(_SEQUENCE_OF_NESTED, 0, 0, _ONE))
    whole = MessageType("tf2_msgs/msg/TFMessage", (field,))
    return TypeDescription(whole, (one.type_description, *one.referenced_type_descriptions))


if __name__ == "__main__":
    main()
