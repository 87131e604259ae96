"""A ROS side without ROS, for what stands in for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.ros.api import RosError
from rsb_bridge.ros.turns import RosTurns

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rsb_bridge.model.calls import Fields
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.api import (
        Endpoint,
        OnFailure,
        Publisher,
        RequestSink,
        ResponseSink,
        ServiceClient,
        ServiceServer,
        Sink,
        Subscription,
    )


class NoRos:
    """A ROS graph that has nothing in it, and takes nothing."""

    instance_id = "0123abcd"
    node_name = "rsb_robot1_0123abcd"
    turns = RosTurns()

    def start(self) -> None:
        pass

    def watch(self, on_graph_change: Callable[[], None], on_failure: Callable[[str], None]) -> None:
        pass

    def stop(self) -> None:
        pass

    def topics(self) -> dict[str, list[str]]:
        return {}

    def publishers(self, topic: str) -> list[Endpoint]:
        return []

    def subscriptions(self, topic: str) -> list[Endpoint]:
        return []

    def services(self) -> dict[str, list[str]]:
        return {}

    def servers(self, service: str) -> list[Endpoint]:
        return []

    def callers(self, service: str) -> list[Endpoint]:
        return []

    def serialize(self, type_name: str, fields: Fields, now: int) -> bytes:
        raise RosError(f"{type_name} is not installed here")

    def installed_description(self, type_name: str) -> str | None:
        return None

    def ask_description(self, *_: object) -> str | None:
        return None

    def installed_hash(self, type_name: str) -> str | None:
        return None

    def installed_service_hash(self, type_name: str) -> str | None:
        return None

    def serve(
        self, service: str, type_name: str, type_hash: str, sink: RequestSink, on_failure: OnFailure | None = None
    ) -> ServiceServer:
        raise RosError("there is no ROS")

    def call_service(
        self, service: str, type_name: str, type_hash: str, sink: ResponseSink, on_failure: OnFailure | None = None
    ) -> ServiceClient:
        raise RosError("there is no ROS")

    def subscribe(
        self,
        topic: str,
        type_name: str,
        type_hash: str,
        qos: Qos,
        sink: Sink,
        origin: Hashable,
        on_failure: OnFailure | None = None,
    ) -> Subscription:
        raise RosError("there is no ROS")

    def advertise(self, topic: str, type_name: str, type_hash: str, qos: Qos, origin: Hashable) -> Publisher:
        raise RosError("there is no ROS")
