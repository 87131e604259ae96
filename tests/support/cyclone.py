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
from cyclonedds.idl import make_idl_struct
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

STRING = make_idl_struct("String", "std_msgs::msg::dds_::String_", {"data": str})
_REQUEST = make_idl_struct("Request", "std_srvs::srv::dds_::SetBool_Request_", {"data": bool})
_RESPONSE = make_idl_struct("Response", "std_srvs::srv::dds_::SetBool_Response_", {"success": bool, "message": str})


class CycloneProgram:
    """One participant."""

    def __init__(self, domain_id: int) -> None:
        self._participant: Any = DomainParticipant(domain_id)
        self._endpoints: list[CycloneWriter | CycloneReader | CycloneCaller] = []

    def writer(self, topic: str, qos: model.Qos = _USUAL, *more: Any) -> CycloneWriter:
        """Write to a topic.

        Args:
            more: policies of Cyclone that ROS does not have.
        """
        given = Qos(*_policies(qos), *more)
        group = Publisher(self._participant, qos=Qos(*(each for each in more if isinstance(each, Policy.Partition))))
        writer = CycloneWriter(DataWriter(group, Topic(self._participant, f"rt{topic}", STRING), given))
        self._endpoints.append(writer)
        return writer

    def reader(self, topic: str, qos: model.Qos = _USUAL, *more: Any) -> CycloneReader:
        """Read from a topic."""
        given, group = Qos(*_policies(qos), *more), Subscriber(self._participant)
        reader = CycloneReader(DataReader(group, Topic(self._participant, f"rt{topic}", STRING), given))
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
        self.entity.write(STRING(data=text), timestamp=stamp)


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
