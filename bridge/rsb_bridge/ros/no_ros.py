"""A ROS graph that has nothing in it, for what plays one: the demo's robots, and tests."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rsb_bridge.ros.discovery import Discovery
from rsb_bridge.ros.ros_interface import Endpoint, NodeEnds, RosError
from rsb_bridge.ros.ros_thread import RosTurns

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rsb_bridge.model.calls import Fields
    from rsb_bridge.ros.ros_interface import (
        EndPlace,
        LostPort,
        Mirroring,
        Publisher,
        ServiceClient,
        ServiceServer,
        Subscription,
    )


class NoMirrors:
    """Mirrors no node."""

    def by_others(self) -> dict[str, str]:
        return {}

    def add(self, node: str) -> None:
        pass

    def remove(self, node: str) -> None:
        pass

    def place(self, end: EndPlace, node: str) -> None:
        pass

    def node_of(self, end: EndPlace) -> str:
        return ""


class NoRos:
    """A ROS graph that has nothing in it, and takes nothing."""

    instance_id = "0123abcd"
    node_name = "_rsb_robot1_0123abcd"
    shortfalls: tuple[str, ...] = ()
    discovery = Discovery({})
    turns = RosTurns()
    mirrors: Mirroring = NoMirrors()

    def start(self) -> None:
        pass

    def watch(self, on_graph_change: Callable[[], None], on_failure: Callable[[str], None]) -> None:
        pass

    def lost_ports(self) -> frozenset[LostPort]:
        return frozenset()

    def stop(self) -> None:
        pass

    def node_names(self) -> list[str]:
        return []

    def ends_of(self, node: str) -> NodeEnds:
        return NodeEnds()

    def topics(self) -> dict[str, list[str]]:
        return {}

    def publishers(self, topic: str) -> list[Endpoint]:
        return []

    def subscriptions(self, topic: str) -> list[Endpoint]:
        return []

    def takes(self, topic: str, besides: Hashable) -> bool:
        return False

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

    def survives_foreign_keys(self, _: str) -> bool:
        return True

    def installed_service_hash(self, type_name: str) -> str | None:
        return None

    def serve(self, *_: Any, **__: Any) -> ServiceServer:
        raise RosError("there is no ROS")

    def call_service(self, *_: Any, **__: Any) -> ServiceClient:
        raise RosError("there is no ROS")

    def subscribe(self, *_: Any, **__: Any) -> Subscription:
        raise RosError("there is no ROS")

    def advertise(self, *_: Any, **__: Any) -> Publisher:
        raise RosError("there is no ROS")
