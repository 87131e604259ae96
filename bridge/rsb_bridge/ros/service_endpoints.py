"""Endpoints of services: raw ones, on rcl through ctypes, and the servers and callers that the graph shows.

A request of ``/name`` travels on the DDS topic ``rq/nameRequest``, a response on ``rr/nameReply`` (ROS 2's design
article on topic and service names). Each endpoint announces the hash of the message that it carries, so that only both
of a server's, or both of a caller's, tell which version of the service it is.

The behaviour of rmw_fastrtps_cpp with calls, and its consequences here:

- A request carries the GUID of the reader that its caller takes responses with, and that is what a server knows a
  caller by. A caller takes responses to it, and responses to its writer of requests.
- A server that responds to a reader that it has had a request of waits for that reader, 100 ms, if it is not matched,
  be it that it was not discovered yet or that it has gone; and the waiting thread keeps the GIL. So an answer to one
  that the graph does not show is kept, and tried again.
- Each client of a service gets the responses to all of them, and a take of another's gives nothing, as if none were
  left. Then the own one behind it would stay until the next response comes, so the client asks whether one is left.
- A server that is to respond to a reader that it has had no request of stays silent, and so does not answer requests
  to an earlier server. To a writer it responds unseen. A client's writer is created right after its reader, while
  its participant creates nothing else, so that its number is the next.
"""

from __future__ import annotations

import ctypes
import itertools
import re
import threading
import time
import warnings
from collections import OrderedDict, deque
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from rclpy.serialization import deserialize_message

from rsb_bridge.model.qos import incompatible
from rsb_bridge.ros.native.fast_cdr import outgoing
from rsb_bridge.ros.native.librcl import (
    CALL_INFO,
    CALLER,
    NO_REQUEST,
    NO_RESPONSE,
    NOT_MATCHED,
    reset_error,
    send_request,
    send_response,
    serialize_message,
    take_request,
    take_response,
)
from rsb_bridge.ros.native.rcl_conversions import endpoint_of
from rsb_bridge.ros.native.rclpy_extension import PUBLISHERS, SUBSCRIPTIONS, reason_of
from rsb_bridge.ros.native.typesupport import joined_hash
from rsb_bridge.ros.ros_interface import Request, Response, RosError, RosProblem

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.native.rclpy_extension import Handle, UntakenResponses
    from rsb_bridge.ros.ros_interface import Endpoint

    AskDds = Callable[..., list[dict[str, Any]]]
    """Asks one of rclpy's questions about a DDS topic."""

_GRAPH_ASKED_AGAIN_AFTER = 0.05
"""s; many answers to callers that have gone must not ask for each."""
_PARTICIPANT = 12
"""Bytes of an endpoint's GUID that all endpoints of a participant share."""
_WRITER = b"\x03"
"""The kind of a writer without key, a GUID's last byte (RTPS 2.5, 9.3.1.2)."""
_IS_READER = 0x04
"""The bit of that byte which readers have and writers have not."""
_DDS_TYPE = re.compile(r"([a-z]\w*)::(srv|action)::dds_::(\w+)_(?:Request|Response)_", re.ASCII)
_CALLERS_REMEMBERED = 1024
"""Callers of one server whose readers it knows. A round figure."""

_CALLER_FOUND_WITHIN = 10.0
"""Seconds that the discovery of a caller may take. A caller that has gone is never discovered.

DDS repeats lost parts of its discovery every 3 s. On one core with 8 busy loops it took 6 s at most, of 190 times.
"""
_LATE_ANSWERS_TRIED_EVERY = 0.2
"""s; a caller that is there, but not matched, holds up everybody for half of that."""
_MOST_LATE_ANSWERS = 1000
_MOST_LATE_BYTES = 16 << 20
"""Of one server. Round figures: callers that go before their answers come must not fill the memory in 10 s."""
_CALLS_REMEMBERED = 5000
"""As many as DDS keeps of one service (`participant._KEPT`)."""


def servers_in_graph(ask: AskDds, service: str) -> list[Endpoint]:
    """Return the servers of a service."""
    return _pairs(
        ask(SUBSCRIPTIONS, f"rq{service}Request"),
        ask(PUBLISHERS, f"rr{service}Reply"),
    )


def callers_in_graph(ask: AskDds, service: str) -> list[Endpoint]:
    """Return the clients of a service."""
    return _pairs(
        ask(PUBLISHERS, f"rq{service}Request"),
        ask(SUBSCRIPTIONS, f"rr{service}Reply"),
    )


def _pairs(requesting: list[dict[str, Any]], responding: list[dict[str, Any]]) -> list[Endpoint]:
    """Return one endpoint for each pair; of a pair, one may be discovered a moment before the other."""
    hashes = {_participant_of(each): endpoint_of(each).type_hash for each in responding}
    found = []
    for info in requesting:
        if (response := hashes.get(_participant_of(info))) is not None:
            endpoint = endpoint_of(info)
            type_hash = joined_hash(endpoint.type_hash, response)
            found.append(endpoint._replace(type_name=_service_type(endpoint.type_name), type_hash=type_hash))
    return found


def _participant_of(info: dict[str, Any]) -> bytes:
    return bytes(info["endpoint_gid"][:_PARTICIPANT])


def _service_type(dds: str) -> str:
    match = _DDS_TYPE.fullmatch(dds)
    return "/".join(match.groups()) if match else dds


def _next_writer(reader: bytes) -> bytes:
    number = int.from_bytes(reader[_PARTICIPANT:15], "big") + 1
    return reader[:_PARTICIPANT] + (number & 0xFFFFFF).to_bytes(3, "big") + _WRITER


class CallerTable:
    """The callers of a service that the graph shows, asked for when it has changed.

    Those whose QoS DDS never matches with the service's are left out: it delivers them no answer.
    """

    def __init__(self, ask: AskDds, service: str, offered: Qos, version: Callable[[], int]) -> None:
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

    def writer_of(self, caller: bytes) -> bytes | None:
        """Return the GUID of a caller's writer of requests, or None if the graph does not show the caller.

        Return empty bytes for a middleware that may not create the reader and the writer one after the other.

        Args:
            caller: the GUID of its reader of responses, or of a caller that names none, its writer's.
        """
        version = self._version()
        # One that was not found is asked for again: the number changes only with the ROS thread's next wait.
        if version == self._asked and (writer := self._known(caller)) is not None:
            return writer
        now = time.monotonic()
        if version != self._asked or now >= self._asked_at + _GRAPH_ASKED_AGAIN_AFTER:
            self._asked, self._asked_at = version, now
            writing = self._ask(PUBLISHERS, f"rq{self._service}Request")
            reading = self._ask(SUBSCRIPTIONS, f"rr{self._service}Reply")
            writers = {bytes(each["endpoint_gid"]) for each in writing}
            readers = [end.gid for each in reading if not incompatible(self._offered, (end := endpoint_of(each)).qos)]
            self._writers = {each: next_ if (next_ := _next_writer(each)) in writers else b"" for each in readers}
        return self._known(caller)

    def _known(self, caller: bytes) -> bytes | None:
        if caller[-1] & _IS_READER:
            return self._writers.get(caller)
        hears = any(reader[:_PARTICIPANT] == caller[:_PARTICIPANT] for reader in self._writers)
        return caller if hears else None


class ServiceEndpoint:
    """A server or a client. One thread takes from it and frees it; any thread sends with it.

    Attributes:
        has_more: whether the last take may have left something.
    """

    kind: Literal["service", "client"]
    express = True

    def __init__(self, handle: Handle, name: str) -> None:
        self.handle = handle
        self.name = name
        self.has_more = False
        self._using = threading.Lock()
        self._closed = False

    def close(self) -> None:
        """Free it. To be called once."""
        # A thread that sends with it has finished then, and the next one finds it closed.
        with self._using:
            self._closed = True
        self.handle.free()

    def take(self, limit: int) -> list[Any] | None:
        """Take up to `limit` of what has come, or return None if DDS gives nothing.

        Raises:
            RosError: rcl failed at the first of them.
        """
        taken: list[Any] = []
        self.has_more = True
        while len(taken) < limit:
            try:
                one = self._take()
            except RosError:
                if taken:  # DDS gives them no second time
                    break
                raise
            if one is None:
                self.has_more = self._has_untaken()
                break
            taken.append(one)
        return taken or None

    def _has_untaken(self) -> bool:
        """Return whether DDS may hold more although the last take gave nothing."""
        return False

    def _take(self) -> Request | Response | None:
        raise NotImplementedError

    def _check_open(self) -> None:
        """Check that it may be used, while `_using` keeps it from being freed.

        Raises:
            RosError: it is closed.
        """
        if self._closed:
            raise RosError(f"{self.name}: the server or client is closed")

    def _failure(self, code: int, failed: str) -> RosError:
        """Return what to raise for an error of rcl's, which is reset."""
        reset_error()
        return RosError(f"{self.name}: {failed} (rcl error {code})")


class RawServiceServer(ServiceEndpoint):
    """A raw service."""

    kind: Literal["service"] = "service"

    def __init__(
        self, handle: Handle, name: str, callers: CallerTable, have_tried: Callable[[RawServiceServer], None]
    ) -> None:
        """Begin to offer it.

        Args:
            have_tried: has `try_again` called soon.
        """
        super().__init__(handle, name)
        self._callers = callers
        self._served: dict[bytes, None] = {}
        self._late = LateAnswers(self._send)
        self._have_tried = have_tried
        self._info = ctypes.create_string_buffer(CALL_INFO.size)

    def _take(self) -> Request | None:
        taken: list[bytes] = []
        # The list is in the place of the ROS message, see `fast_cdr`.
        code = take_request(self.handle.address, self._info, id(taken))
        if code == NO_REQUEST:
            return None
        if code:
            raise self._failure(code, "a request could not be taken")
        source, _, guid, number = CALL_INFO.unpack(self._info)
        self._served[guid] = None
        if len(self._served) > _CALLERS_REMEMBERED:  # forgotten callers are answered as an earlier server's
            del self._served[next(iter(self._served))]
        # rmw_fastrtps_cpp gives the time at which it was sent, by the caller's clock, for that at which it came.
        return Request(taken.pop(), CALLER.pack(guid, number), time.time_ns(), source=source)

    def answer(self, caller: bytes, payload: bytes) -> None:
        """Answer a call; see `rsb_bridge.ros.ros_interface.ServiceServer.answer`.

        Raises:
            RosError: it is closed, the payload is no message, or the middleware refused it.
        """
        guid, number = CALLER.unpack(caller)
        with self._using:
            self._check_open()
            if not self._late.send(guid, number, payload):
                self._have_tried(self)

    def try_again(self) -> bool:
        """Send answers that could not be sent before. Whether some still could not."""
        try:
            with self._using:
                self._check_open()
                return self._late.try_again()
        except RosError:
            return False

    def _send(self, guid: bytes, number: int, payload: bytes) -> bool:
        """Send an answer if the caller is in the graph; return whether it was sent."""
        writer = self._callers.writer_of(guid)
        if writer is None:
            return False
        to = guid if guid in self._served else writer
        if not to:
            raise RosError(
                f"{self.name}: this caller asked an earlier server: its middleware takes no answer of this one"
            )
        # In a variable, as the middleware gets only its address.
        writing = outgoing(payload)
        code = send_response(self.handle.address, CALLER.pack(to, number), id(writing))
        if code == NOT_MATCHED:
            reset_error()
        elif code:
            raise self._failure(code, "an answer could not be sent")
        return not code


class _Client(ServiceEndpoint):
    kind: Literal["client"] = "client"

    def __init__(self, handle: Handle, name: str, untaken: UntakenResponses) -> None:
        super().__init__(handle, name)
        self._untaken = untaken

    def _has_untaken(self) -> bool:
        with _refused(self.name):
            return self._untaken.has(self.handle.rclpy)

    @property
    def ready(self) -> bool:
        """Whether a server is matched; False once closed."""
        try:
            available: bool = self.handle.rclpy.service_server_is_available()
        except RuntimeError:
            return False
        return available


class RawServiceClient(_Client):
    """A raw client of a service."""

    def __init__(self, handle: Handle, name: str, untaken: UntakenResponses) -> None:
        super().__init__(handle, name, untaken)
        self._info = ctypes.create_string_buffer(CALL_INFO.size)

    def _take(self) -> Response | None:
        taken: list[bytes] = []
        code = take_response(self.handle.address, self._info, id(taken))
        if code == NO_RESPONSE:
            return None
        if code:
            raise self._failure(code, "a response could not be taken")
        _, stamp, _, number = CALL_INFO.unpack(self._info)
        return Response(taken.pop(), number, stamp)

    def call(self, payload: bytes) -> int:
        """Send a request; see `rsb_bridge.ros.ros_interface.ServiceClient.call`.

        Raises:
            RosError: it is closed, the payload is no message, or the middleware refused it.
        """
        number = ctypes.c_int64()
        with self._using:
            self._check_open()
            # In a variable, as the middleware gets only its address.
            writing = outgoing(payload)
            code = send_request(self.handle.address, id(writing), number)
            if code:
                raise self._failure(code, "a request could not be sent")
        return number.value


class _Answer(NamedTuple):
    """An answer that is kept.

    Attributes:
        number: of the caller's request.
    """

    number: int
    payload: bytes
    since: float


class LateAnswers:
    """Sends answers in order, caller by caller; keeps unsent answers, and tries again for a while."""

    def __init__(self, send: Callable[[bytes, int, bytes], bool]) -> None:
        """Begin with none.

        Args:
            send: sends an answer, given its caller, the number of the request and the response. Whether it could.
        """
        self._send = send
        self._kept: dict[bytes, deque[_Answer]] = {}
        self._tried_at = 0.0

    def send(self, caller: bytes, number: int, payload: bytes) -> bool:
        """Send an answer, or keep it; return whether it was sent.

        Raises:
            RosError: it cannot be sent at all, or there is no room to keep it.
        """
        if caller not in self._kept and self._send(caller, number, payload):
            return True
        sizes = [len(each.payload) for answers in self._kept.values() for each in answers]
        if len(sizes) >= _MOST_LATE_ANSWERS or sum(sizes) + len(payload) > _MOST_LATE_BYTES:
            raise RosError(RosProblem.TOO_MANY_ANSWERS_WAIT(count=len(sizes)))
        self._kept.setdefault(caller, deque()).append(_Answer(number, payload, time.monotonic()))
        return False

    def try_again(self) -> bool:
        """Send the kept answers where possible, and give up old ones; return whether some remain."""
        now = time.monotonic()
        if now >= self._tried_at + _LATE_ANSWERS_TRIED_EVERY:
            self._tried_at = now
            for caller, answers in tuple(self._kept.items()):
                while answers and self._is_settled(caller, answers[0], now):
                    answers.popleft()
                if not answers:
                    del self._kept[caller]
        return bool(self._kept)

    def _is_settled(self, caller: bytes, answer: _Answer, now: float) -> bool:
        try:
            return now > answer.since + _CALLER_FOUND_WITHIN or self._send(caller, answer.number, answer.payload)
        except RosError:
            return True  # the answering side does not wait for the result


# rclpy reports each answer to a caller that has gone on stderr, where a terminal user interface may be.
warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)

_numbers = itertools.count(1)
_asked: OrderedDict[bytes, Any] = OrderedDict()
"""What rclpy knows callers by, of calls that were not answered yet.

It is the process's, as a later server of the same service may have to answer them.
"""


class TypedServer(ServiceEndpoint):
    """A service whose package is installed, where its calls cannot be carried raw; as `RawServiceServer`.

    With another middleware, or another version of it, rclpy takes and sends the messages, and they are serialized here.
    That costs some 10 µs to ms a call, by the size of its messages. It is left to the middleware whether an answer
    reaches a caller that asked an earlier server.
    """

    kind: Literal["service"] = "service"

    def __init__(self, handle: Handle, name: str, service_class: Any) -> None:
        super().__init__(handle, name)
        self._request, self._response = service_class.Request, service_class.Response

    def _take(self) -> Request | None:
        with _refused(self.name):
            message, info = self.handle.rclpy.service_take_request(self._request)
        if message is None:
            return None
        caller = next(_numbers).to_bytes(8, "big")
        _asked[caller] = info.request_id
        if len(_asked) > _CALLS_REMEMBERED:
            _asked.popitem(last=False)
        return Request(serialize_message(message), caller, time.time_ns(), source=info.source_timestamp)

    def answer(self, caller: bytes, payload: bytes) -> None:
        """Answer a call."""
        with self._using, _refused(self.name):
            self._check_open()
            message = deserialize_message(payload, self._response)
            if (request_id := _asked.pop(caller, None)) is not None:
                self.handle.rclpy.service_send_response(message, request_id)


class TypedClient(_Client):
    """A client of a service; as `RawServiceClient`."""

    def __init__(self, handle: Handle, name: str, untaken: UntakenResponses, service_class: Any) -> None:
        super().__init__(handle, name, untaken)
        self._request, self._response = service_class.Request, service_class.Response

    def _take(self) -> Response | None:
        with _refused(self.name):
            info, message = self.handle.rclpy.take_response(self._response)
        if message is None:
            return None
        return Response(serialize_message(message), info.request_id.sequence_number, info.received_timestamp)

    def call(self, payload: bytes) -> int:
        """Send a request."""
        with self._using, _refused(self.name):
            self._check_open()
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
