"""Helpers of `test_parameters` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.parameter_client import AsyncParameterClient
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.spun import Spun


def parameters(node: str, **changes: Any) -> Topic:
    return Topic(node, "receive", kind="parameters", **changes)


def client_of(spun: Spun, node: str) -> AsyncParameterClient:
    """Return a program's client of a far node's parameters, once they exist."""
    client = AsyncParameterClient(spun.node, node)
    eventually(client.services_are_ready, what=f"the parameters of {node}")
    return client
