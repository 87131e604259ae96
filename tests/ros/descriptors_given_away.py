"""Whether DDS writes to the number of a closed descriptor: ``python -m tests.ros.descriptors_given_away DOMAIN``.

Readers of a topic that another process floods are added and removed. Another descriptor gets each one's number at once.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from typing import TYPE_CHECKING
from unittest.mock import patch

from tests.support.waiting import eventually

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.participant import Participant
from rsb_bridge.ros.ros_interface import TopicSpec

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_ROUNDS = 60
_SPEC = TopicSpec("/flood", "std_msgs/msg/String", "", Qos("best_effort"))
_FLOOD = """
import sys, time
from tests.support.participants import KnownNode
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import TopicSpec
node = KnownNode(int(sys.argv[1]), "flood")
node.start()
publisher = node.advertise(TopicSpec("/flood", "std_msgs/msg/String", "", Qos("best_effort")), "link")
print("there", flush=True)
while True:
    for _ in range(20):
        publisher.publish(bytes.fromhex("00010000020000006100"))
    time.sleep(0.001)
"""


class _GivenAway(list[int]):
    """Descriptors that have the numbers of closed ones."""

    def __init__(self, close: Callable[[int], None]) -> None:
        super().__init__()
        self._close = close

    def close(self, descriptor: int) -> None:
        """Take the place of `os.close`."""
        self._close(descriptor)
        self.append(os.eventfd(0, os.EFD_NONBLOCK))
        assert self[-1] <= descriptor  # the lowest free number

    def were_written_to(self) -> bool:
        """Close all of them."""
        written = False
        while self:
            descriptor = self.pop()
            with contextlib.suppress(BlockingIOError):
                written |= bool(os.eventfd_read(descriptor))
            self._close(descriptor)
        return written


def main(domain: int) -> None:
    participant = Participant(domain, "here")
    given_away = _GivenAway(os.close)
    with _flooding(domain), patch.object(os, "close", given_away.close):
        for number in range(_ROUNDS):
            reader = participant.create_reader(_SPEC)
            participant.arrivals.add(reader)
            eventually(lambda reader=reader: reader.handle.address in participant.wait(1.0)[0] and reader.matched)
            eventually(lambda reader=reader: reader.take(64, ()))
            participant.arrivals.remove(reader)
            assert given_away
            time.sleep(0.005)  # some 100 messages come to the reader, which nobody is told of
            participant.free(reader)
            assert not given_away.were_written_to(), number
    participant.leave()
    sys.stdout.write(f"{_ROUNDS} closed\n")


@contextlib.contextmanager
def _flooding(domain: int) -> Iterator[None]:
    """Publish 20,000 messages a second from another process, so that DDS's threads call back without the GIL."""
    with subprocess.Popen((sys.executable, "-c", _FLOOD, str(domain)), stdout=subprocess.PIPE) as program:
        assert program.stdout is not None
        program.stdout.readline()
        try:
            yield
        finally:
            program.kill()


if __name__ == "__main__":
    main(int(sys.argv[1]))
