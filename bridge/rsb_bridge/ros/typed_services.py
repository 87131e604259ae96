"""Endpoints of services whose package is installed, where their calls cannot be carried raw.

With another middleware, or another version of it, rclpy takes and sends the messages, and they are serialized here.
That costs some 10 µs to ms a call, by the size of its messages. It is left to the middleware whether an answer reaches
a caller that asked an earlier server.
"""

from __future__ import annotations

import itertools
import time
import warnings
from collections import OrderedDict
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

from rclpy.serialization import deserialize_message

from rsb_bridge.ros.api import Request, Response, RosError
from rsb_bridge.ros.librcl import reason_of, reset_error
from rsb_bridge.ros.serialization import serialize_message
from rsb_bridge.ros.service_endpoints import ServiceEndpoint, is_ready

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.ros.librcl import Handle

_CALLS_REMEMBERED = 5000

# rclpy says so on stderr, where a terminal user interface may be, of each answer to a caller that has gone.
warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)

_numbers = itertools.count(1)
_asked: OrderedDict[bytes, Any] = OrderedDict()
"""What rclpy knows callers by, of the process's calls that were not answered yet."""


class TypedServer(ServiceEndpoint):
    """A service; as `rsb_bridge.ros.service_endpoints.Server`."""

    kind: Literal["service"] = "service"

    def __init__(self, handle: Handle, name: str, service_class: Any) -> None:
        super().__init__(handle, name)
        self._request, self._response = service_class.Request, service_class.Response

    def take(self, limit: int) -> list[Request]:
        """Take up to `limit` calls."""
        requests: list[Request] = []
        for _ in range(limit):
            with _refused(self.name):
                message, info = self.handle.rclpy.service_take_request(self._request)
            if message is None:
                break
            caller = next(_numbers).to_bytes(8, "big")
            _asked[caller] = info.request_id
            requests.append(Request(serialize_message(message), caller, time.time_ns(), source=info.source_timestamp))
        while len(_asked) > _CALLS_REMEMBERED:
            _asked.popitem(last=False)
        return requests

    def answer(self, caller: bytes, payload: bytes) -> None:
        """Answer a call."""
        with self._open(), _refused(self.name):
            message = deserialize_message(payload, self._response)
            if (request_id := _asked.pop(caller, None)) is not None:
                self.handle.rclpy.service_send_response(message, request_id)


class TypedClient(ServiceEndpoint):
    """A client of a service; as `rsb_bridge.ros.service_endpoints.Client`."""

    kind: Literal["client"] = "client"

    def __init__(self, handle: Handle, name: str, service_class: Any) -> None:
        super().__init__(handle, name)
        self._request, self._response = service_class.Request, service_class.Response

    @property
    def ready(self) -> bool:
        """Whether a server is matched; no once closed."""
        return is_ready(self.handle)

    def take(self, limit: int) -> list[Response]:
        """Take up to `limit` answers."""
        responses: list[Response] = []
        for _ in range(limit):
            with _refused(self.name):
                info, message = self.handle.rclpy.take_response(self._response)
            if message is None:
                break
            number, stamp = info.request_id.sequence_number, info.received_timestamp
            responses.append(Response(serialize_message(message), number, stamp))
        return responses

    def call(self, payload: bytes) -> int:
        """Send a request."""
        with self._open(), _refused(self.name):
            number: int = self.handle.rclpy.send_request(deserialize_message(payload, self._request))
        return number


@contextmanager
def _refused(service: str) -> Iterator[None]:
    """Say what rclpy does not do as a `RosError`."""
    try:
        yield
    except RuntimeError as error:
        reset_error()
        raise RosError(f"{service}: {reason_of(error)}") from error
