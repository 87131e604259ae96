"""Errors are reported in an operator's words, once."""

from __future__ import annotations

import contextlib
import itertools
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from tests.ros.domains import ANOTHER
from tests.support import replaced
from tests.support.waiting import eventually
from tests.support.wording import pattern, says

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.type_names import TypeNameProblem
from rsb_bridge.ros.node import RosNode
from rsb_bridge.ros.participant import Participant
from rsb_bridge.ros.publication_numbers import Untaken
from rsb_bridge.ros.ros_interface import RosError, RosProblem, TopicSpec

STRING, SET = "std_msgs/msg/String", "std_srvs/srv/SetBool"


def test_errors_say_what_and_what_to_do(open_node: Callable[..., RosNode], printed: Callable[[], list[str]]) -> None:
    """And rcl itself says nothing: there may be a terminal user interface where it would."""
    node = open_node()
    node.advertise(TopicSpec("/taken", STRING, "", Qos()), "link")
    publisher = node.advertise(TopicSpec("/chat", STRING, "", Qos()), "link")
    with pytest.raises(RosError, match=f"/chat: {pattern(RosProblem.MESSAGE_TOO_SHORT, length=2)}"):
        publisher.publish(b"hi")
    publisher.close()
    publisher.close()
    assert publisher.subscriber_count == 0
    with pytest.raises(RosError, match=f"^/chat: {pattern(RosProblem.CLOSED)}$"):
        publisher.publish(bytes(8))
    with pytest.raises(RosError, match=pattern(RosProblem.INVALID_NAME, name="/no spaces", kind="topic")):
        node.advertise(TopicSpec("/no spaces", STRING, "", Qos()), "link")
    with pytest.raises(RosError, match=pattern(RosProblem.INVALID_NAME, name="/7", kind="topic")):
        node.subscribe(TopicSpec("/7", STRING, "", Qos()), print, "link")
    with pytest.raises(RosError, match=r"^/taken: .*incompatible type std_msgs::msg::dds_::Int8_$"):
        node.advertise(TopicSpec("/taken", "std_msgs/msg/Int8", "", Qos()), "link")
    assert not printed()
    with pytest.raises(RosError, match=pattern(TypeNameProblem.INVALID, name="String")):
        node.subscribe(TopicSpec("/chat", "String", "", Qos()), print, "link")
    assert node.installed_hash("String") is None
    assert node.installed_hash("no_such_msgs/msg/Name") is None
    with pytest.raises(RosError, match=pattern(RosProblem.STARTED_TWICE)):
        node.start()
    node.stop()
    with pytest.raises(RosError, match=pattern(RosProblem.NOT_RUNNING)):
        node.topics()


@pytest.mark.parametrize("domain_id", [-1, 233])
def test_a_domain_that_cannot_be_joined(domain_id: int) -> None:
    with pytest.raises(RosError, match=pattern(RosProblem.NO_SUCH_DOMAIN, domain=domain_id, domains="0 to 232")):
        RosNode(domain_id, "robot1").start()


def test_what_rcl_refuses_is_said() -> None:
    """A null address makes a subscription that rcl finds broken."""
    participant = Participant(ANOTHER, "reader")
    reader = participant.create_reader(TopicSpec("/chat", STRING, "", Qos()))
    reader.handle.address = 0
    with pytest.raises(RosError, match=pattern(RosProblem.NOT_TAKEN, topic="/chat")):
        reader.take(1, ())
    reader.close()
    participant.leave()
    with pytest.raises(RosError, match=pattern(RosProblem.GRAPH_UNREADABLE)):
        participant.topics()


def test_what_was_taken_before_error_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    for place in (replaced.TAKE_MESSAGE, replaced.TAKE_REQUEST, replaced.TAKE_RESPONSE):
        codes = itertools.count()

        def fails_each_second_time(*args: object, take: Any = place.value, codes: Iterator[int] = codes) -> int:
            return next(codes) % 2 or take(*args)

        place.set(monkeypatch, fails_each_second_time)
    participant = Participant(ANOTHER, "reader")
    reader = participant.create_reader(TopicSpec("/chat", STRING, "", Qos()))
    writer = participant.create_writer(TopicSpec("/chat", STRING, "", Qos()))
    server = participant.create_server("/set", SET, "")
    client = participant.create_client("/set", SET, "")
    eventually(lambda: writer.matched and client.ready)

    def takes(take: Callable[[], Sequence[Any] | None], count: int) -> list[Any]:
        taken: list[Any] = []

        def have_come() -> bool:
            with contextlib.suppress(RosError):
                taken.extend(take() or ())
            return len(taken) >= count

        eventually(have_come)
        return taken

    for _ in range(3):
        writer.publish(bytes(9))
        client.call(b"\0\1\0\0\0")
    takes(lambda: reader.take(10, ()), 3)
    assert reader.numbers.counts[Untaken.LOST] == 0
    for request in takes(lambda: server.take(10), 3):
        server.answer(request.caller, b"\0\1" + bytes(11))
    takes(lambda: client.take(10), 3)
    for each in (reader, writer, server, client):
        each.close()
    participant.leave()


def test_without_rclpy_it_says_how_to_get_it() -> None:
    program = (
        "import sys; sys.modules['rclpy'] = None\n"
        "from rsb_bridge.ros.ros_interface import RosError\n"
        "from rsb_bridge.ros.node import RosNode\n"
        "try: RosNode(20, 'robot1').start()\n"
        "except RosError as error: print(error)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=300)
    assert says(run.stdout, RosProblem.NOT_INSTALLED)
