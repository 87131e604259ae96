"""Raw endpoints of services, on rcl through ctypes. Structs: rmw/types.h (ROS 2 Jazzy).

What rmw_fastrtps_cpp does with a call, and what follows from it here:

- A request carries the GUID of the reader that its caller takes responses with, and that is what a server knows a
  caller by. A caller takes responses to it, and responses to its writer of requests.
- A server that responds to a reader that it has had a request of waits for that reader, 100 ms, if it is not matched,
  be it that it was not discovered yet or that it has gone; and the waiting thread keeps the GIL. So an answer to one
  that the graph does not show is kept, and tried again.
- A server that is to respond to a reader that it has had no request of stays silent, and so does not answer what was
  asked of an earlier server. To a writer it responds unseen. A client's writer is created right after its reader, while
  its participant creates nothing else, so that its number is the next.
"""

from __future__ import annotations

import ctypes
import struct
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

from rsb_bridge.ros.api import Request, Response, RosError
from rsb_bridge.ros.late_answers import LateAnswers
from rsb_bridge.ros.librcl import librcl, reset_error
from rsb_bridge.ros.raw_cdr import outgoing

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.ros.librcl import Handle
    from rsb_bridge.ros.service_graph import CallerTable

_NO_REQUEST = 601  # RCL_RET_SERVICE_TAKE_FAILED
_NO_RESPONSE = 501  # RCL_RET_CLIENT_TAKE_FAILED
_NOT_MATCHED = 2  # RCL_RET_TIMEOUT
_CALLERS_REMEMBERED = 1024

CALLER = struct.Struct("@16sq")
"""A rmw_request_id_t: a GUID, and the number of the caller's request."""

_INFO = struct.Struct("@qq16sq")
"""A rmw_service_info_t: source and reception time in ns, and whose call it is."""

_take_request = librcl.rcl_take_request_with_info
_take_request.argtypes = [ctypes.c_void_p] * 3
_take_response = librcl.rcl_take_response_with_info
_take_response.argtypes = [ctypes.c_void_p] * 3
_send_request = librcl.rcl_send_request
_send_request.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.POINTER(ctypes.c_int64)]
_send_response = librcl.rcl_send_response
_send_response.argtypes = [ctypes.c_void_p] * 3


class ServiceEndpoint:
    """A server or a client. One thread takes from it and frees it; any thread sends with it.

    Attributes:
        handle: rclpy's.
        name: the service's, resolved.
    """

    def __init__(self, handle: Handle, name: str) -> None:
        self.handle = handle
        self.name = name
        self._using = threading.Lock()
        self._closed = False

    def close(self) -> None:
        """Free it. To be called once."""
        with self._using:
            self._closed = True
        self.handle.free()

    @contextmanager
    def _open(self) -> Iterator[None]:
        """Keep it from being freed.

        Raises:
            RosError: it is closed.
        """
        with self._using:
            if self._closed:
                raise RosError(f"{self.name}: the server or client is closed")
            yield


class Server(ServiceEndpoint):
    """A raw service.

    Attributes:
        kind: what it is in a wait set.
    """

    kind: Literal["service"] = "service"

    def __init__(self, handle: Handle, name: str, callers: CallerTable, have_tried: Callable[[Server], None]) -> None:
        """Begin to offer it.

        Args:
            handle: rclpy's.
            name: the service's, resolved.
            callers: the service's.
            have_tried: has `try_again` called soon.
        """
        super().__init__(handle, name)
        self._callers = callers
        self._served: dict[bytes, None] = {}
        self._late = LateAnswers(self._send)
        self._have_tried = have_tried
        self._info = ctypes.create_string_buffer(_INFO.size)

    def take(self, limit: int) -> list[Request]:
        """Take up to `limit` calls.

        Raises:
            RosError: rcl failed.
        """
        address, info = self.handle.address, self._info
        taken: list[bytes] = []
        requests = []
        for _ in range(limit):
            code = _take_request(address, info, id(taken))
            if code:
                _check(code, _NO_REQUEST, self.name, "a request could not be taken")
                break
            source, _, guid, number = _INFO.unpack(info)
            self._served[guid] = None
            # rmw_fastrtps_cpp gives the time at which it was sent, by the caller's clock, for that at which it came.
            requests.append(Request(taken.pop(), CALLER.pack(guid, number), time.time_ns(), source=source))
        while len(self._served) > _CALLERS_REMEMBERED:  # those that are forgotten are answered as an earlier server's
            del self._served[next(iter(self._served))]
        return requests

    def answer(self, caller: bytes, payload: bytes) -> None:
        """Answer a call; see `rsb_bridge.ros.api.ServiceServer.answer`.

        Raises:
            RosError: it is closed, the payload is no message, or the middleware refused it.
        """
        guid, number = CALLER.unpack(caller)
        with self._open():
            if not self._late.send(guid, number, payload):
                self._have_tried(self)

    def try_again(self) -> bool:
        """Send answers that could not be sent before. Whether some still could not."""
        try:
            with self._open():
                return self._late.try_again()
        except RosError:
            return False

    def _send(self, guid: bytes, number: int, payload: bytes) -> bool:
        """Whether the caller is known, so that an answer could be sent."""
        writer = self._callers.writer_of(guid)
        if writer is None:
            return False
        to = guid if guid in self._served else writer
        if not to:
            raise RosError(f"{self.name}: who asked an earlier server cannot be answered with this caller's middleware")
        writing = outgoing(payload)
        code = _send_response(self.handle.address, CALLER.pack(to, number), id(writing))
        if code:
            _check(code, _NOT_MATCHED, self.name, "an answer could not be sent")
        return not code


class Client(ServiceEndpoint):
    """A raw client of a service.

    Attributes:
        kind: what it is in a wait set.
    """

    kind: Literal["client"] = "client"

    def __init__(self, handle: Handle, name: str) -> None:
        super().__init__(handle, name)
        self._info = ctypes.create_string_buffer(_INFO.size)

    @property
    def ready(self) -> bool:
        """Whether a server is matched; no once closed."""
        return is_ready(self.handle)

    def take(self, limit: int) -> list[Response]:
        """Take up to `limit` answers.

        Raises:
            RosError: rcl failed.
        """
        address, info = self.handle.address, self._info
        taken: list[bytes] = []
        responses = []
        for _ in range(limit):
            code = _take_response(address, info, id(taken))
            if code:
                _check(code, _NO_RESPONSE, self.name, "a response could not be taken")
                break
            _, stamp, _, number = _INFO.unpack(info)
            responses.append(Response(taken.pop(), number, stamp))
        return responses

    def call(self, payload: bytes) -> int:
        """Send a request; see `rsb_bridge.ros.api.ServiceClient.call`.

        Raises:
            RosError: it is closed, the payload is no message, or the middleware refused it.
        """
        number = ctypes.c_int64()
        with self._open():
            writing = outgoing(payload)
            code = _send_request(self.handle.address, id(writing), number)
            if code:
                _check(code, 0, self.name, "a request could not be sent")
        return number.value


def is_ready(client: Handle) -> bool:
    """Whether a client has a server that is matched; no once it is freed."""
    try:
        available: bool = client.rclpy.service_server_is_available()
    except RuntimeError:
        return False
    return available


def _check(code: int, expected: int, service: str, failed: str) -> None:
    """Take note of an error of rcl's.

    Raises:
        RosError: it is not the expected one.
    """
    reset_error()
    if code != expected:
        raise RosError(f"{service}: {failed} (rcl error {code})")
