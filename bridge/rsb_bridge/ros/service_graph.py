"""Servers and callers of services, from the endpoints of the DDS topics that calls travel on.

A request of ``/name`` travels on ``rq/nameRequest``, a response on ``rr/nameReply`` (ROS 2's design article on topic
and service names). Each endpoint announces the hash of the message that it carries, so that only both of a server's, or
both of a caller's, tell which version of the service it is.
"""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING, Any

from rsb_bridge.model.qos import incompatible
from rsb_bridge.ros.native.rclpy_extension import PUBLISHERS, SUBSCRIPTIONS, endpoint_of
from rsb_bridge.ros.native.typesupport import joined_hash

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import Endpoint

    Ask = Callable[..., list[dict[str, Any]]]
    """Asks one of rclpy's questions about a DDS topic."""

_ASKS_AGAIN_AFTER = 0.05
"""s; many answers to callers that have gone must not ask for each."""
_PARTICIPANT = 12
"""Bytes of an endpoint's GUID that all endpoints of a participant share."""
_WRITER = b"\x03"
"""The kind of a writer without key, a GUID's last byte (RTPS 2.5, 9.3.1.2)."""
_DDS_TYPE = re.compile(r"([a-z]\w*)::(srv|action)::dds_::(\w+)_(?:Request|Response)_", re.ASCII)


def servers(ask: Ask, service: str) -> list[Endpoint]:
    """Return the servers of a service."""
    return _pairs(
        ask(SUBSCRIPTIONS, f"rq{service}Request"),
        ask(PUBLISHERS, f"rr{service}Reply"),
    )


def callers(ask: Ask, service: str) -> list[Endpoint]:
    """Return the clients of a service."""
    return _pairs(
        ask(PUBLISHERS, f"rq{service}Request"),
        ask(SUBSCRIPTIONS, f"rr{service}Reply"),
    )


class CallerTable:
    """The callers of a service that the graph shows, asked for when it has changed.

    Those whose QoS DDS never matches with the service's are left out: it delivers them no answer.
    """

    def __init__(self, ask: Ask, service: str, offered: Qos, version: Callable[[], int]) -> None:
        """Ask nothing yet.

        Args:
            version: another number when the graph has changed.
        """
        self._ask = ask
        self._service = service
        self._offered = offered
        self._version = version
        self._asked = -1
        self._asked_at = 0.0
        self._writers: dict[bytes, bytes] = {}

    def writer_of(self, reader: bytes) -> bytes | None:
        """Return the GUID of a caller's writer of requests, or None if the graph does not show the caller.

        Return empty bytes for a middleware that may not create the reader and the writer one after the other.

        Args:
            reader: the GUID of its reader of responses.
        """
        version = self._version()
        # One that was not found is asked for again: the number changes only with the ROS thread's next wait.
        if version == self._asked and (writer := self._writers.get(reader)) is not None:
            return writer
        now = time.monotonic()
        if version != self._asked or now >= self._asked_at + _ASKS_AGAIN_AFTER:
            self._asked, self._asked_at = version, now
            writing = self._ask(PUBLISHERS, f"rq{self._service}Request")
            reading = self._ask(SUBSCRIPTIONS, f"rr{self._service}Reply")
            writers = {bytes(each["endpoint_gid"]) for each in writing}
            readers = [end.gid for each in reading if not incompatible(self._offered, (end := endpoint_of(each)).qos)]
            self._writers = {each: next_ if (next_ := _next_writer(each)) in writers else b"" for each in readers}
        return self._writers.get(reader)


def _pairs(requesting: list[dict[str, Any]], responding: list[dict[str, Any]]) -> list[Endpoint]:
    """Return one endpoint for each pair; of a pair, one may be discovered a moment before the other."""
    hashes = {_participant(each): endpoint_of(each).type_hash for each in responding}
    found = []
    for info in requesting:
        if (response := hashes.get(_participant(info))) is not None:
            endpoint = endpoint_of(info)
            type_hash = joined_hash(endpoint.type_hash, response)
            found.append(endpoint._replace(type_name=_type_name(endpoint.type_name), type_hash=type_hash))
    return found


def _participant(info: dict[str, Any]) -> bytes:
    return bytes(info["endpoint_gid"][:_PARTICIPANT])


def _type_name(dds: str) -> str:
    match = _DDS_TYPE.fullmatch(dds)
    return "/".join(match.groups()) if match else dds


def _next_writer(reader: bytes) -> bytes:
    number = int.from_bytes(reader[_PARTICIPANT:15], "big") + 1
    return reader[:_PARTICIPANT] + (number & 0xFFFFFF).to_bytes(3, "big") + _WRITER
