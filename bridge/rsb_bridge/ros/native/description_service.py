"""Descriptions of types that other nodes use, by a service of these nodes."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from rclpy.type_support import check_for_type_support

from rsb_bridge.cdr.description import DESCRIPTION_LIMIT, TypeDescription, text_of
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.native.rclpy_extension import UntakenResponses
from rsb_bridge.ros.native.rosidl_descriptions import message_type

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable

    from rclpy.context import Context

    from rsb_bridge.ros.native.rclpy_extension import OwnNode

_SERVED_WITHIN = 0.5  # s: from when the client exists to when DDS has matched it
_ANSWERED_WITHIN = 2.0  # s: a round figure
_SLICE_NS = 50_000_000
"""Between two questions whether the answer is still wanted: a bridge that stops waits for this one's end."""
_QOS = Qos("reliable", "volatile", "keep_last", 10)
"""That of services by default (rmw/qos_profiles.h)."""


def ask_node(
    own: OwnNode,
    context: Context,
    node: str,
    type_name: str,
    type_hash: str,
    still_wanted: Callable[[], bool],
    entities: threading.RLock,
) -> str | None:
    """Ask a node for the description of a type that it uses, by its ``~/get_type_description`` service.

    Takes some seconds at most.

    Args:
        node: full name of the node to ask.
        still_wanted: asked several times a second; False ends the waiting.
        entities: held while our node's endpoints are created or freed.

    Returns:
        The text, or None if the node lacks that service or does not answer.

    Raises:
        RuntimeError: rcl failed.
    """
    try:
        from type_description_interfaces.srv import GetTypeDescription  # noqa: PLC0415 (not every ROS has it)
    except ImportError:
        return None
    check_for_type_support(GetTypeDescription)  # which the extension module takes for loaded
    with entities:
        entity = own.create("client", GetTypeDescription, f"{node}/get_type_description", _QOS)
    client, untaken = entity.rclpy, UntakenResponses(context)
    try:
        deadline = time.monotonic() + _SERVED_WITHIN
        # A request to a server that DDS has not matched yet is lost.
        while not client.service_server_is_available():
            if time.monotonic() > deadline or not still_wanted():
                return None
            time.sleep(_SLICE_NS / 1e9)
        client.send_request(GetTypeDescription.Request(type_name=type_name, type_hash=type_hash))
        deadline = time.monotonic() + _ANSWERED_WITHIN
        while time.monotonic() < deadline and still_wanted():
            if untaken.wait(client, _SLICE_NS):
                _, answer = client.take_response(GetTypeDescription.Response)
                if answer is not None:  # else it was another client's
                    return _answered(answer)
    finally:
        untaken.close()
        with entities:
            entity.destroy()
    return None


def _answered(answer: Any) -> str | None:
    if not answer.successful:
        return None
    described = answer.type_description
    types = (described.type_description, *described.referenced_type_descriptions)
    if sum(len(each.fields) for each in types) > DESCRIPTION_LIMIT // 32:  # each takes more characters than that
        return None
    found = [message_type(each, list(each.fields)) for each in types]
    return text_of(TypeDescription(found[0], tuple(found[1:])))
