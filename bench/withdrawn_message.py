"""A fault of Fast DDS 2.14.5: a withdrawn message stays in its reader, and is given for ever.

``python -m bench.withdrawn_message [--typed] [DOMAIN]`` needs `cyclonedds`, whose writer withdraws a message by an RTPS
GAP. The writer keeps ten messages, and writes 200 of 1 MB a second: more than arrives, so that many are withdrawn while
the reader has a part of them. The program prints each second what a stock subscription of rclpy got. Once a message was
withdrawn, that is one without a byte as often as the reader looks: until the next message comes, or for ever. The exit
code is 1 then.

With ``--typed``, messages are deserialized by Fast DDS, which then does not return from `take`: nothing is printed any
more, and only SIGKILL ends the program.

The cause is in `StatefulReader::processGapMsg` (the same in 3.6.2). For an incomplete sample it calls
`History::remove_change_nts`, and not the function of `DataReaderHistory` that overrides it. So the sample goes back to
its pool, or is freed if the reader's `historyMemoryPolicy` is DYNAMIC, but the instance's `cache_changes` still point
to it. `DataReader::take` returns it, and `DataReaderHistory::remove_change_sub` does not find it in the history, and
leaves the pointer where it is.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time

import rclpy
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from std_msgs.msg import String

_TOPIC = "withdrawn"
_SIZE, _COUNT, _RATE = 1_000_000, 1000, 200
_SECONDS = 15
_TEXT = make_idl_struct("String", "std_msgs::msg::dds_::String_", {"data": str})
_ON_LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<Peers><Peer address='localhost'/></Peers></Discovery></Domain></CycloneDDS>"
)


def write(domain: int) -> None:
    """Write by Cyclone DDS."""
    os.environ["CYCLONEDDS_URI"] = _ON_LOOPBACK
    qos = Qos(
        Policy.Reliability.Reliable(duration(seconds=10)),
        Policy.History.KeepLast(10),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    participant = DomainParticipant(domain)
    writer = DataWriter(participant, Topic(participant, f"rt/{_TOPIC}", _TEXT, qos=qos), qos=qos)
    while not writer.get_matched_subscriptions():
        time.sleep(0.1)
    message = _TEXT(data="x" * _SIZE)
    for _ in range(_COUNT):
        writer.write(message)
        time.sleep(1 / _RATE)


def read(domain: int, *, typed: bool) -> int:
    """Print what a subscription gets. Return the program's exit code."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    rclpy.init(domain_id=domain)
    node = rclpy.create_node("reader")
    count = empty = empties = 0

    def got(message: bytes | String) -> None:
        nonlocal count, empty
        count += 1
        empty += message == b""

    node.create_subscription(String, _TOPIC, got, 10, raw=not typed)
    writing = subprocess.Popen([sys.executable, "-m", "bench.withdrawn_message", "write", str(domain)])
    for second in range(1, _SECONDS + 1):
        until = time.monotonic() + 1
        while time.monotonic() < until:
            rclpy.spin_once(node, timeout_sec=0.1)
        gone = "" if writing.poll() is None else ", the writer has gone"
        sys.stdout.write(f"second {second}: {count} messages, {empty} of them without a byte{gone}\n")
        empties += empty
        count = empty = 0
    writing.wait()
    node.destroy_node()
    rclpy.shutdown()
    return int(empties > 0)


def main() -> None:
    """Run one part."""
    arguments = sys.argv[1:]
    domain = int(arguments[-1]) if arguments and arguments[-1].isdigit() else 0
    if arguments[:1] == ["write"]:
        write(domain)
    else:
        sys.exit(read(domain, typed="--typed" in arguments))


if __name__ == "__main__":
    main()
