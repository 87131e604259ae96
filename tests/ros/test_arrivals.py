"""DDS tells which endpoints something has come to, and no descriptor of theirs is written to after its end."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.ros.domains import ANOTHER
from tests.support import constants, replaced
from tests.support.resources import resources
from tests.support.waiting import eventually

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.participant import Participant
from rsb_bridge.ros.ros_interface import RosError, TopicSpec

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.ros.arrivals import Incoming
    from rsb_bridge.ros.node import RosNode

STRING, SET = "std_msgs/msg/String", "std_srvs/srv/SetBool"
REQUEST = b"\0\1\0\0\0\0\0\0"
PAYLOAD = b"\0\1\0\0\2\0\0\0a\0"


def strings(topic: str) -> TopicSpec:
    return TopicSpec(topic, STRING, "", Qos())


@pytest.fixture
def participant() -> Iterator[Participant]:
    made = Participant(ANOTHER, "here")
    yield made
    made.leave()


@pytest.fixture
def other() -> Iterator[Participant]:
    made = Participant(ANOTHER, "there")
    yield made
    made.leave()


def reported(participant: Participant, within: float = 0.0) -> list[int]:
    return participant.wait(within)[0]


@pytest.mark.usefixtures("told")
def test_earlier_messages_are_reported(participant: Participant, other: Participant) -> None:
    reader, writer = participant.create_reader(strings("/early")), other.create_writer(strings("/early"))
    eventually(lambda: writer.matched)
    writer.publish(PAYLOAD)
    eventually(lambda: writer.acknowledged)
    participant.arrivals.add(reader)
    eventually(lambda: reader.handle.address in reported(participant, 1.0))
    assert [each.payload for each in reader.take(10, ()) or ()] == [PAYLOAD]
    participant.free(reader)
    writer.close()


def test_message_is_reported_though_rmw_missed_it(
    participant: Participant, other: Participant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may come between rmw's count of what is there and the start of its listener (rmw_fastrtps)."""
    monkeypatch.setitem(replaced.ON_ARRIVAL.value, "subscription", lambda *_: 0)
    reader, writer = participant.create_reader(strings("/missed")), other.create_writer(strings("/missed"))
    eventually(lambda: writer.matched)
    writer.publish(PAYLOAD)
    eventually(lambda: writer.acknowledged)
    participant.arrivals.add(reader)
    assert reported(participant, 60.0) == [reader.handle.address]
    assert reader.take(10, ())
    participant.free(reader)
    writer.close()


@pytest.mark.parametrize("told", ["events"], indirect=True)
@pytest.mark.usefixtures("told")
def test_only_what_is_express_ends_a_rest(participant: Participant, other: Participant) -> None:
    ordinary = participant.create_reader(strings("/ordinary"))
    express = participant.create_reader(strings("/express"), express=True)
    writers = [other.create_writer(strings(reader.topic)) for reader in (ordinary, express)]
    for reader in (ordinary, express):
        participant.arrivals.add(reader)
    eventually(lambda: all(each.matched for each in writers))
    while participant.wait(0.0, 0.01)[0]:
        pass

    def publish(*which: int) -> None:
        for each in which:
            writers[each].publish(PAYLOAD)
            eventually(lambda each=each: writers[each].acknowledged)

    publish(0)
    began = time.monotonic()
    assert participant.wait(0.0, 0.3)[0] == [ordinary.handle.address]
    assert time.monotonic() - began >= 0.3
    publish(0, 1)
    assert participant.wait(0.0, 600.0)[0] == [express.handle.address, ordinary.handle.address]
    participant.wake()
    assert participant.wait(0.0, 600.0)[0] == []
    for each in (ordinary, express):
        participant.free(each)
    for writer in writers:
        writer.close()


@pytest.mark.usefixtures("told")
def test_each_kind_is_reported(participant: Participant, other: Participant) -> None:
    server, client = participant.create_server("/set", SET, ""), other.create_client("/set", SET, "")
    participant.arrivals.add(server)
    other.arrivals.add(client)
    eventually(lambda: client.ready)
    client.call(REQUEST)

    def taken(participant: Participant, endpoint: Any) -> Any:
        return endpoint.handle.address in reported(participant, 1.0) and endpoint.take(10)

    (request,) = eventually(lambda: taken(participant, server))
    server.answer(request.caller, b"\0\1" + bytes(11))
    assert len(eventually(lambda: taken(other, client))) == 1
    participant.free(server)
    other.free(client)


@pytest.mark.parametrize("told", ["events"], indirect=True)
@pytest.mark.usefixtures("told")
def test_call_is_looked_at_once(open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch) -> None:
    """Each look asks DDS until it gives nothing."""
    provider, caller = open_node(name="provider"), open_node(name="caller")
    looks = 0
    take = replaced.TAKE_REQUEST.value

    def counted(*args: object) -> Any:
        nonlocal looks
        looks += 1
        return take(*args)

    replaced.TAKE_REQUEST.set(monkeypatch, counted)
    requests: list[Any] = []
    provider.serve("/set", SET, "", requests.extend)
    client = caller.call_service("/set", SET, "", lambda _: None)
    eventually(lambda: client.ready and looks)
    for number in range(1, 11):
        client.call(REQUEST)
        eventually(lambda number=number: len(requests) == number)
    assert looks <= 3 + 10 * 2  # the first ones when it was made


@pytest.mark.usefixtures("told")
def test_look_again_reports_once_more(participant: Participant) -> None:
    reader = participant.create_reader(strings("/left"))
    participant.arrivals.add(reader)
    while reported(participant):
        pass
    if not participant.arrivals.repeats:  # a wait set reports what has something anyway
        participant.arrivals.look_again(reader.handle.address, 0.0)
        assert reported(participant, 60.0) == [reader.handle.address]
    assert reported(participant) == []
    participant.free(reader)


@pytest.mark.usefixtures("told")
def test_resting_endpoint_is_not_reported(participant: Participant, other: Participant) -> None:
    reader, writer = participant.create_reader(strings("/rests")), other.create_writer(strings("/rests"))
    quiet = participant.create_reader(strings("/quiet"))
    for each in (reader, quiet):
        participant.arrivals.add(each)
    eventually(lambda: writer.matched)
    while reported(participant):
        pass
    participant.arrivals.look_again(reader.handle.address, 0.5)
    began = time.monotonic()
    writer.publish(PAYLOAD)
    found = list[int]()
    while reader.handle.address not in found:
        found = reported(participant, 60.0)
    assert time.monotonic() - began >= 0.5
    assert reader.take(10, ())
    for each in (reader, quiet):
        participant.free(each)
    writer.close()


def test_sharing_endpoints_never_rest(open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch) -> None:
    """They are looked at for each other's messages, and give nothing then."""
    constants.NOTHING_A_SECOND.set(monkeypatch, 0)
    replaced.DESCRIPTORS_FOR_ARRIVALS.set(monkeypatch, lambda _: 1)
    node, there = open_node(), open_node(name="other")
    taken: dict[str, list[Any]] = {name: [] for name in ("/own", "/shared", "/shared_too")}
    failures: list[Any] = []
    for name, batches in taken.items():
        node.subscribe(strings(name), batches.extend, "link", failures.append)
    publishers = {name: there.advertise(strings(name), "link") for name in taken}
    for each in publishers.values():
        eventually(lambda each=each: each.subscriber_count)
    for number in range(1, 101):
        publishers["/shared"].publish(PAYLOAD)
        eventually(lambda number=number: len(taken["/shared"]) == number)
    for name in ("/own", "/shared_too"):
        publishers[name].publish(PAYLOAD)
        eventually(lambda name=name: taken[name])
    assert not failures


def test_descriptors_are_shared_evenly(
    participant: Participant, other: Participant, monkeypatch: pytest.MonkeyPatch
) -> None:
    replaced.DESCRIPTORS_FOR_ARRIVALS.set(monkeypatch, lambda _: 3)
    readers = [participant.create_reader(strings(f"/even_{number}")) for number in range(8)]
    for each in readers:
        participant.arrivals.add(each)
    while reported(participant, 0.1):
        pass
    for number, reader in enumerate(readers):
        writer = other.create_writer(strings(f"/even_{number}"))
        eventually(lambda writer=writer: writer.matched)
        writer.publish(PAYLOAD)
        found = eventually(lambda: reported(participant, 1.0))
        assert reader.handle.address in found
        assert len(found) == 2  # of eight readers and four descriptors
        writer.close()
    for each in readers:
        participant.free(each)


def test_endpoints_share_where_none_is_left(participant: Participant, monkeypatch: pytest.MonkeyPatch) -> None:
    readers = [participant.create_reader(strings(f"/scarce_{number}")) for number in range(3)]

    def none_left(*_: object) -> int:
        raise OSError("too many open files")

    participant.arrivals.add(readers[0])
    monkeypatch.setattr(os, "eventfd", none_left)
    for each in readers[1:]:
        participant.arrivals.add(each)
    found: set[int] = set()

    def all_are_reported() -> bool:
        found.update(reported(participant))
        return len(found) == len(readers)

    eventually(all_are_reported)
    for each in readers:
        participant.free(each)


def test_domain_is_not_joined_without_descriptors(monkeypatch: pytest.MonkeyPatch) -> None:
    before = resources()

    def none_left(*_: object) -> int:
        raise OSError("too many open files")

    monkeypatch.setattr(os, "eventfd", none_left)
    with pytest.raises(RosError, match="too many open files"):
        Participant(ANOTHER, "here")
    eventually(lambda: resources().threads <= before.threads)


def test_descriptors_are_closed() -> None:
    participant = Participant(ANOTHER, "here")
    before = resources().descriptors

    def kept() -> list[Incoming]:
        made: list[Incoming] = [participant.create_reader(strings(f"/many_{number}")) for number in range(20)]
        made += [participant.create_server("/set", SET, ""), participant.create_client("/set", SET, "")]
        for each in made:
            participant.arrivals.add(each)
        return made

    endpoints = kept()
    assert resources().descriptors >= before + len(endpoints)
    for each in endpoints:
        participant.free(each)
    eventually(lambda: resources().descriptors <= before)
    participant.leave()


def test_number_of_closed_descriptor_is_never_written_to() -> None:
    """In a process of its own: who frees a reader while DDS matches one may end with it (Fast DDS #3303)."""
    command = (sys.executable, "-m", "tests.ros.descriptors_given_away", str(ANOTHER))
    ended = subprocess.run(
        command, cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=300, check=False
    )
    assert (ended.returncode, ended.stdout) == (0, "60 closed\n"), ended.stderr


def test_removing_waits_for_event_under_way(
    participant: Participant, other: Participant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In place of `eventfd_write`, DDS calls a function that takes long: `usleep` of the descriptor's number of µs."""
    import ctypes

    microseconds = 400_000
    usleep = ctypes.cast(ctypes.CDLL(None).usleep, ctypes.c_void_p)
    reader, writer = participant.create_reader(strings("/slow")), other.create_writer(strings("/slow"))
    eventually(lambda: writer.matched)
    set_callback = replaced.ON_ARRIVAL.value["subscription"]
    payload = PAYLOAD + bytes(512 << 10)  # which is published without the GIL

    def waited() -> bool:
        assert not set_callback(reader.handle.address, usleep, microseconds)
        publishing = threading.Thread(target=writer.publish, args=(payload,))
        publishing.start()
        time.sleep(0.1)
        began = time.monotonic()
        assert not set_callback(reader.handle.address, None, None)
        passed = time.monotonic() - began
        publishing.join()
        reader.take(10, ())
        return passed > microseconds / 4e6

    eventually(waited)
    reader.close()
    writer.close()


def test_failed_watch_of_graph_ends_the_thread(
    open_node: Callable[..., RosNode], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> bool:
        raise RuntimeError("the wait set is broken")

    node, failures = open_node(), list[str]()
    node.watch(lambda: None, failures.append)
    replaced.WAIT_FOR_GRAPH.set(monkeypatch, broken)
    node.advertise(strings("/graph"), "test")  # which ends the present wait
    eventually(lambda: failures)
    assert "the wait set is broken" in failures[0]
