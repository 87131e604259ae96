"""The ROS nodes at both ends, each in a process of its own, and what they note.

``python -m tests.system.torture.ends talk PC ROBOT`` publishes the lines of its input in the control PC's domain, and
`WITNESS` in the robot's own domain. ``... listen ROBOT FILE`` records the messages that reach the robot.
"""

from __future__ import annotations

import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tests.support.asked import Asked, answers
from tests.system.torture.program import started

from rsb_bridge.model.text import keep_output_clean

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from rclpy.publisher import Publisher

WITNESS = "/witness"
"""Published in the robot's domain itself: the time that it takes is the harness's own."""
VELOCITY = 0.2
"""m/s of each numbered Twist."""

_WITNESS_RATE = 50.0
_ARRIVAL = struct.Struct("<HIddd")
_POLL = 0.003
_PIPES: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}


class Arrival(NamedTuple):
    """A message that reached the robot; times are s of CLOCK_MONOTONIC.

    Attributes:
        topic: its name in the robot's domain.
        number: counts up from 1 for each topic; 0 for a Twist with zero velocity.
        published: the moment before the control PC's node published it.
        arrived: the moment when the robot's node got it, as DDS says.
        bridged: the moment when the robot's bridge gave it to DDS, by the clock of that bridge.
    """

    topic: str
    number: int
    published: float
    arrived: float
    bridged: float


class Talker(Asked):
    """Publishes commands in the control PC's domain.

    Args:
        pc: the control PC's domain.
        robot: the robot's.
        environ: of the process, in addition to this one's.
    """

    def __init__(self, pc: int, robot: int, environ: Mapping[str, str] | None = None) -> None:
        super().__init__(started(__name__, "talk", str(pc), str(robot), environ=environ, **_PIPES))

    def talk(self, topics: Iterable[str], rate: float, *, twist: bool = False) -> None:
        """Publish each topic at `rate` Hz from now on, and nothing else; with `twist`, as velocities."""
        self.ask(topics=[*topics], rate=rate, twist=twist)


class Ear(Asked):
    """Listens in the robot's domain."""

    def __init__(self, robot: int, file: Path) -> None:
        self._file = file
        self._topics: list[str] = []
        super().__init__(started(__name__, "listen", str(robot), str(file), **_PIPES))

    def listen(self, topics: Iterable[str], *, twist: bool = False) -> None:
        """Listen to these topics, as Twist or String, and to `WITNESS`, and forget all that was noted."""
        self._topics = [WITNESS, *topics]
        self.ask(topics=self._topics, twist=twist)

    def arrivals(self) -> list[Arrival]:
        """All messages since `listen`, the witness's included."""
        self.ask(flush=True)
        data = self._file.read_bytes()
        whole = len(data) // _ARRIVAL.size * _ARRIVAL.size  # the ear may be writing
        return [Arrival(self._topics[topic], *rest) for topic, *rest in _ARRIVAL.iter_unpack(data[:whole])]


class _Voice:
    """One topic that is published."""

    def __init__(self, publisher: Publisher, rate: float, *, twist: bool = False) -> None:
        self.publisher = publisher
        self._twist = twist
        self.number = 0
        self.due = time.monotonic()
        self._interval = 1 / rate

    def work(self, now: float) -> None:
        from tests.support.domain import text

        self.due = max(self.due + self._interval, now)
        self.number += 1
        if self._twist:
            self.publisher.publish(_twist(x=VELOCITY, y=float(self.number), z=time.monotonic()))
        else:
            self.publisher.publish(text(f"{self.number} {time.monotonic()!r}"))


def _twist(**linear: float) -> Any:
    from geometry_msgs.msg import Twist, Vector3

    return Twist(linear=Vector3(**linear))


def talk(pc: int, robot: int) -> None:
    """Publish until the input ends."""
    from std_msgs.msg import String
    from tests.support.domain import Domain

    domain, own = Domain(pc), Domain(robot)
    witness = _Voice(own.publisher(WITNESS), _WITNESS_RATE)
    voices: dict[str, _Voice] = {}

    def act(order: dict[str, Any]) -> None:
        nonlocal voices
        domain.clear()
        twist = order["twist"]
        kind = type(_twist()) if twist else String
        voices = {name: _Voice(domain.publisher(name, kind), order["rate"], twist=twist) for name in order["topics"]}

    def due() -> float:
        return min(each.due for each in (witness, *voices.values()))

    while answers(act, max(0.0, due() - time.monotonic())):
        now = time.monotonic()
        for voice in (witness, *voices.values()):
            if voice.due <= now:
                voice.work(now)


def listen(robot: int, file: Path) -> None:
    """Record messages until the input ends."""
    from std_msgs.msg import String
    from tests.support.domain import RELIABLE, Domain

    domain = Domain(robot)
    subscriptions: list[Any] = []
    shift = time.time() - time.monotonic()
    output = file.open("wb", buffering=0)

    def act(order: dict[str, Any]) -> None:
        nonlocal subscriptions
        if "topics" in order:
            domain.clear()
            twist = type(_twist()) if order["twist"] else String
            kinds = {name: String if name == WITNESS else twist for name in order["topics"]}
            subscribe = domain.node.create_subscription
            subscriptions = [subscribe(kind, name, lambda _: None, RELIABLE) for name, kind in kinds.items()]
            output.truncate(0)
            output.seek(0)

    while answers(act, _POLL):
        for index, subscription in enumerate(subscriptions):
            while (taken := subscription.handle.take_message(subscription.msg_type, False)) is not None:
                message, info = taken
                number, published = _noted(message)
                arrived, bridged = (info[key] / 1e9 - shift for key in ("received_timestamp", "source_timestamp"))
                output.write(_ARRIVAL.pack(index, int(number), float(published), arrived, bridged))


def _noted(message: Any) -> tuple[str | float, str | float]:
    """Return a message's number and the time when it was published; a velocity by hand has the number 1 and no time."""
    if hasattr(message, "data"):
        number, published = message.data.split()
        return number, published
    linear, angular = message.linear, message.angular
    return linear.y or float(any((linear.x, linear.z, angular.z))), linear.z


if __name__ == "__main__":
    keep_output_clean()
    if sys.argv[1] == "talk":
        talk(int(sys.argv[2]), int(sys.argv[3]))
    else:
        listen(int(sys.argv[2]), Path(sys.argv[3]))
