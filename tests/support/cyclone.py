"""Programs of a domain that are no ROS nodes: a participant of Cyclone DDS with writers and readers of std_msgs/String.

``python -m tests.support.cyclone DOMAIN TOPIC`` writes numbers, 20 a second, until it is killed.
"""

from __future__ import annotations

import itertools
import os
import sys
import time
from typing import TYPE_CHECKING, Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from rsb_bridge.model import qos as model

if TYPE_CHECKING:
    from collections.abc import Iterator

os.environ["CYCLONEDDS_URI"] = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>64</MaxAutoParticipantIndex><LeaseDuration>2s</LeaseDuration>"
    "<Peers><Peer address='localhost'/></Peers></Discovery></Domain></CycloneDDS>"
)
_MOST = 1000
_USUAL = model.Qos()

_TYPE = "std_msgs::msg::dds_::String_"
STRING = make_idl_struct("String", _TYPE, {"data": str})
KEYED = make_idl_struct("String", _TYPE, {"data": str}, field_annotations={"data": {"key": True}})
"""Among the policies of an endpoint: its type is a String whose text is a key."""
TIME = make_idl_struct("Time", "builtin_interfaces::msg::dds_::Time_", {"sec": types.int32, "nanosec": types.uint32})
"""Another type, in the same place."""
NAMED = make_idl_struct(
    "Named", "made_up_msgs::msg::dds_::Named_", {"data": str}, field_annotations={"data": {"key": True}}
)
"""A type with a key that is installed nowhere."""
KEYED_STRING = make_idl_struct(
    "KeyedString",
    "test_msgs::msg::dds_::KeyedString_",
    {"key": str, "value": str},
    field_annotations={"key": {"key": True}},
)
"""A type with a key that is installed from Kilted on."""
_OTHER_TYPES = (KEYED, TIME, NAMED, KEYED_STRING)
HASH = "RIHS01_" + 32 * "5a"
HASHED = Policy.Userdata(f"typehash={HASH};".encode())
"""Tells ROS a hash of the type."""
XCDR2 = Policy.DataRepresentation(use_xcdrv2_representation=True)
_REQUEST = make_idl_struct("Request", "std_srvs::srv::dds_::SetBool_Request_", {"data": bool})
_RESPONSE = make_idl_struct("Response", "std_srvs::srv::dds_::SetBool_Response_", {"success": bool, "message": str})


class CycloneProgram:
    """One participant.

    Args:
        is_node: whether it looks to ROS like a node that has not told its name.
    """

    def __init__(self, domain_id: int, *, is_node: bool = False) -> None:
        enclave = [Policy.Userdata(b"enclave=/;")] if is_node else []
        self._participant: Any = DomainParticipant(domain_id, qos=Qos(*enclave))
        self._endpoints: list[CycloneWriter | CycloneReader | CycloneCaller] = []

    def writer(self, topic: str, qos: model.Qos = _USUAL, *more: Any) -> CycloneWriter:
        """Write to a topic.

        Args:
            more: policies of Cyclone that ROS does not have, or a type.
        """
        given, type_, partition = _given(qos, more)
        group = Publisher(self._participant, qos=partition)
        writer = CycloneWriter(DataWriter(group, Topic(self._participant, f"rt{topic}", type_), given))
        self._endpoints.append(writer)
        return writer

    def reader(self, topic: str, qos: model.Qos = _USUAL, *more: Any) -> CycloneReader:
        """Read from a topic."""
        given, type_, partition = _given(qos, more)
        group = Subscriber(self._participant, qos=partition)
        reader = CycloneReader(DataReader(group, Topic(self._participant, f"rt{topic}", type_), given))
        self._endpoints.append(reader)
        return reader

    def caller(self, service: str) -> CycloneCaller:
        """Call a service of type std_srvs/SetBool by a request that names no reader of responses, only its writer."""
        asking = Topic(self._participant, f"rq{service}Request", _REQUEST)
        hearing = Topic(self._participant, f"rr{service}Reply", _RESPONSE)
        qos = Qos(*_policies(_USUAL))
        caller = CycloneCaller(
            DataWriter(Publisher(self._participant), asking, qos),
            DataReader(Subscriber(self._participant), hearing, qos),
        )
        self._endpoints.append(caller)
        return caller

    def close(self) -> None:
        """Take them out of the domain. The last reference to one does so, and a failed test's traceback holds more."""
        for each in self._endpoints:
            each.entity = None
        self._endpoints.clear()
        self._participant = None


class CycloneWriter:
    def __init__(self, writer: Any) -> None:
        self.entity = writer

    @property
    def matched(self) -> int:
        return len(self.entity.get_matched_subscriptions())

    def publish(self, text: str, stamp: int | None = None) -> None:
        """Publish, at `stamp` (ns since the epoch) by its clock."""
        self.entity.write(self.entity.data_type(data=text), timestamp=stamp)


class CycloneReader:
    def __init__(self, reader: Any) -> None:
        self.entity = reader
        self._texts: list[str] = []

    @property
    def texts(self) -> list[str]:
        """All that has come so far."""
        # The end of a writer is a sample, too, without data.
        self._texts += [each.data for each in self.entity.take(_MOST) if each.sample_info.valid_data]
        return self._texts


class CycloneCaller(CycloneReader):
    def __init__(self, writer: Any, reader: Any) -> None:
        super().__init__(reader)
        self._writer = writer

    def call(self) -> None:
        self._writer.write(_REQUEST(data=True))

    @property
    def answers(self) -> list[str]:
        """The messages of new responses."""
        return [each.message for each in self.entity.take(_MOST) if each.sample_info.valid_data]


def _given(qos: model.Qos, more: tuple[Any, ...]) -> tuple[Qos, Any, Qos]:
    """Return the QoS of an endpoint, its type, and the QoS of the group that it is in."""
    policies = {
        each.__scope__: each for each in (*_policies(qos), *(each for each in more if each not in _OTHER_TYPES))
    }
    partition = Qos(*(each for each in more if isinstance(each, Policy.Partition)))
    return Qos(*policies.values()), next((each for each in more if each in _OTHER_TYPES), STRING), partition


def _policies(qos: model.Qos) -> Iterator[Any]:
    yield Policy.DataRepresentation(use_cdrv0_representation=True)
    reliable = Policy.Reliability.Reliable(duration(seconds=10))
    yield reliable if qos.reliability == "reliable" else Policy.Reliability.BestEffort
    kept = Policy.History.KeepLast(qos.depth) if qos.history == "keep_last" else Policy.History.KeepAll
    yield kept
    if qos.latched:
        yield Policy.Durability.TransientLocal
        yield Policy.DurabilityService(duration(seconds=0), kept, _MOST, 1, _MOST)
    if qos.deadline:
        yield Policy.Deadline(duration(seconds=qos.deadline))
    if qos.lifespan:
        yield Policy.Lifespan(duration(seconds=qos.lifespan))
    if qos.liveliness_lease_duration:
        alive = Policy.Liveliness.ManualByTopic if qos.liveliness == "manual_by_topic" else Policy.Liveliness.Automatic
        yield alive(duration(seconds=qos.liveliness_lease_duration))


def main() -> None:
    domain, topic = sys.argv[1:]
    writer = CycloneProgram(int(domain)).writer(topic)
    for number in itertools.count():
        writer.publish(str(number))
        time.sleep(0.05)


if __name__ == "__main__":
    main()
