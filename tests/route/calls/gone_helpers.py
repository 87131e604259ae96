"""Helpers of `test_gone` and others."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from tests.support.offline import half_of

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.route.calls.provider import Provider

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context


LAMP = Endpoint("/lamp", "std_srvs/srv/SetBool", "RIHS01_0", Qos(), b"lamp")


class Graph(NoRos):
    def __init__(self) -> None:
        self.found: list[Endpoint] = []
        self.looks = 0
        self.respond: Any = None
        self.client = SimpleNamespace(ready=True, call=lambda request: 1, close=lambda: None)

    def servers(self, service: str) -> list[Endpoint]:
        self.looks += 1
        return self.found

    def installed_service_hash(self, type_name: str) -> str | None:
        return LAMP.type_hash

    def call_service(self, name: str, type_name: str, type_hash: str, put: Any, failed: object) -> Any:
        self.respond = put
        return self.client


def providing(ros: Graph, make_context: Callable[..., Context]) -> Provider:
    half = half_of(Provider, make_context(ros), Topic("/set", "transmit", kind="service"), here=False)
    half.route.open(1)
    half.route.on_accepted()
    return half
