"""What the bridge uses of ROS's C client library, rcl: a participant in one domain and its raw endpoints.

rclpy's executors cost three times what is needed here, and its `Node` brings a publisher and services that nobody would
serve. So this works on the extension module under rclpy, and calls rcl itself for the two things that it hides: the
publisher of a message taken, and changes of the graph. Structs: rmw/types.h, rcl/wait.h, rcutils/types/uint8_array.h,
rcutils/allocator.h (ROS 2 Jazzy).
"""

from __future__ import annotations

import ctypes
import struct
import time
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy

from rsb_bridge.model.limits import DOMAIN, TOPIC_LENGTH
from rsb_bridge.model.names import is_topic_name
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.anytype import message_class
from rsb_bridge.ros.api import Endpoint, RawMessage, RosError
from rsb_bridge.ros.conversions import endpoint_of, rcl_profile, safe_type_name
from rsb_bridge.ros.descriptions import ask_node

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

_ARGUMENTS = ["--ros-args", "--disable-rosout-logs", "--disable-stdout-logs", "--disable-external-lib-logs"]
"""ROS arguments of ours alone, not the process's; and no log line of rcl's may garble a terminal user interface."""

_TAKE_FAILED = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED: there is no message
_KEPT = 5000  # messages: Fast DDS's limit on a history that keeps all
_PUBLISHERS_REMEMBERED = 1024
_DISCOVERED_WITHIN = 5.0  # s: how long a publisher that was there before may take to be found
_LAST_NUMBER = 2**63 - 1

_INFO = struct.Struct("@qqQQP16s?0P")
"""rmw_message_info_t: source and reception time in ns, publication and reception number, publisher's gid (its
middleware's name and 16 bytes), whether it came within the process."""


class _Allocator(ctypes.Structure):
    """A rcutils_allocator_t."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in ("allocate", "deallocate", "reallocate", "zero", "state"))


class _Buffer(ctypes.Structure):
    """A rcl_serialized_message_t: a buffer that rcl makes larger as it needs."""

    _fields_ = (
        ("data", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class _Gid(ctypes.Structure):
    """A rmw_gid_t."""

    _fields_ = (("middleware", ctypes.c_char_p), ("value", ctypes.c_uint8 * 16))


class _WaitSetHead(ctypes.Structure):
    """The first fields of a rcl_wait_set_t. After a wait, what was not triggered is NULL."""

    _fields_ = (
        ("subscriptions", ctypes.c_void_p),
        ("subscription_count", ctypes.c_size_t),
        ("guard_conditions", ctypes.POINTER(ctypes.c_void_p)),
        ("guard_condition_count", ctypes.c_size_t),
    )


# PyDLL keeps the GIL: these take about 1 µs, and giving it up each time would cost a whole switch interval whenever
# another thread is busy. rclpy has loaded the libraries; librcl's handle also finds what it depends on.
_rcl = ctypes.PyDLL("librcl.so")
_take = _rcl.rcl_take_serialized_message
_take.argtypes = [ctypes.c_void_p] * 4
_reset_error = _rcl.rcutils_reset_error
_publisher_handle = _rcl.rcl_publisher_get_rmw_handle
_publisher_handle.argtypes, _publisher_handle.restype = [ctypes.c_void_p], ctypes.c_void_p
_gid_of_publisher = _rcl.rmw_get_gid_for_publisher
_gid_of_publisher.argtypes = [ctypes.c_void_p, ctypes.POINTER(_Gid)]
_default_allocator = _rcl.rcutils_get_default_allocator
_default_allocator.restype = _Allocator
_buffer_init = _rcl.rcutils_uint8_array_init
_buffer_init.argtypes = [ctypes.POINTER(_Buffer), ctypes.c_size_t, ctypes.POINTER(_Allocator)]
_buffer_fini = _rcl.rcutils_uint8_array_fini
_buffer_fini.argtypes = [ctypes.POINTER(_Buffer)]
_graph_guard_condition = _rcl.rcl_node_get_graph_guard_condition
_graph_guard_condition.argtypes, _graph_guard_condition.restype = [ctypes.c_void_p], ctypes.c_void_p
_add_guard_condition = _rcl.rcl_wait_set_add_guard_condition
_add_guard_condition.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]


class Ready(NamedTuple):
    """What ended a wait.

    Attributes:
        readers: the addresses of those that have messages.
        graph_changed: a node, publisher or subscription came or went.
    """

    readers: list[int]
    graph_changed: bool


class Participant:
    """Our one node in one domain. The graph may be asked from any thread; `wait` and readers belong to one thread."""

    def __init__(self, domain_id: int, node_name: str) -> None:
        """Join the domain.

        Raises:
            RosError: the domain cannot be joined.
        """
        if domain_id not in DOMAIN:
            raise RosError(f"ROS domain {domain_id} cannot be joined: domains are {DOMAIN}")
        self._context = Context()
        try:
            self._context.init(_ARGUMENTS, domain_id=domain_id)
            self._node = _rclpy.Node(node_name, "/", self._context.handle, [], False, False)
        except RuntimeError as error:
            self._context.try_shutdown()
            raise RosError(f"ROS domain {domain_id} cannot be joined: {_reason(error)}") from error
        self._name = self._node.get_fully_qualified_name()
        self._guard = _rclpy.GuardCondition(self._context.handle)
        self._graph_guard = _graph_guard_condition(self._node.pointer)
        self._graph_guard_index = ctypes.c_size_t()
        self._waits, self._capacity = self._wait_set(0), 0
        self._buffer = _Buffer()
        _buffer_init(self._buffer, 0, _default_allocator())

    def leave(self) -> None:
        """Leave the domain; every endpoint is closed before."""
        _buffer_fini(self._buffer)
        for handle in (self._waits, self._guard, self._node):
            handle.destroy_when_not_in_use()
        self._context.shutdown()
        self._context.destroy()

    def topics(self) -> dict[str, list[str]]:
        """Every topic that ROS can subscribe to, our own node's too, with its type names."""
        found = self._ask(_rclpy.rclpy_get_topic_names_and_types)
        return {
            name: [safe_type_name(each) for each in types]
            for name, types in found
            if len(name) <= TOPIC_LENGTH and is_topic_name(name)
        }

    def publishers(self, topic: str) -> list[Endpoint]:
        """The publishers on a topic, our own left out."""
        return self._others(self._ask(_rclpy.rclpy_get_publishers_info_by_topic, topic))

    def subscriptions(self, topic: str) -> list[Endpoint]:
        """The subscriptions on a topic, our own left out."""
        return self._others(self._ask(_rclpy.rclpy_get_subscriptions_info_by_topic, topic))

    def ask_description(
        self, node: str, type_name: str, type_hash: str, still_wanted: Callable[[], bool]
    ) -> str | None:
        """What another node tells of a type that it uses; see `rsb_bridge.ros.descriptions.ask_node`.

        Raises:
            RosError: rcl failed.
        """
        try:
            return ask_node(self._node, self._context.handle, node, type_name, type_hash, still_wanted)
        except RuntimeError as error:
            _reset_error()
            raise RosError(f"{node} cannot be asked: {_reason(error)}") from error

    def create_reader(self, topic: str, type_name: str, type_hash: str, qos: Qos) -> Reader:
        """A raw subscription.

        Raises:
            RosError: the type, the name or the QoS will not do.
        """
        latched = qos.latched
        earlier = None if latched else frozenset(each.gid for each in self.publishers(topic))
        handle = self._create(_rclpy.Subscription, topic, type_name, type_hash, qos)
        return Reader(handle, self._buffer, earlier)

    def create_writer(self, topic: str, type_name: str, type_hash: str, qos: Qos) -> Writer:
        """A raw publisher; errors as `create_reader`.

        One that keeps all would make its caller wait 100 ms a message once a slow reader has fallen a whole history
        behind, and then refuse the message; so it keeps the same number and lets the oldest go instead.
        """
        kept = Qos(qos.reliability, qos.durability, "keep_last", _KEPT, qos.deadline, qos.lifespan)
        handle = self._create(_rclpy.Publisher, topic, type_name, type_hash, kept if qos.history == "keep_all" else qos)
        return Writer(handle)

    def wait(self, readers: Collection[Reader]) -> Ready:
        """Block until a reader has messages, the graph changes, or `wake` is called."""
        if len(readers) != self._capacity:
            self._waits.destroy_when_not_in_use()
            self._waits, self._capacity = self._wait_set(len(readers)), len(readers)
        waits = self._waits
        waits.clear_entities()
        waits.add_guard_condition(self._guard)
        _add_guard_condition(waits.pointer, self._graph_guard, self._graph_guard_index)
        for reader in readers:
            waits.add_subscription(reader.handle)
        waits.wait(-1)
        head = _WaitSetHead.from_address(waits.pointer)
        graph_changed = bool(head.guard_conditions[self._graph_guard_index.value])
        return Ready(waits.get_ready_entities("subscription"), graph_changed)

    def wake(self) -> None:
        """Make `wait` return, now or the next time it is called. From any thread."""
        self._guard.trigger_guard_condition()

    def _wait_set(self, readers: int) -> Any:
        # subscriptions, guard conditions, timers, clients, services, events
        return _rclpy.WaitSet(readers, 2, 0, 0, 0, 0, self._context.handle)

    def _create(self, kind: Any, topic: str, type_name: str, type_hash: str, qos: Qos) -> Any:
        message = message_class(type_name, type_hash)
        try:
            return kind(self._node, message, topic, rcl_profile(qos).get_c_qos_profile())
        except ValueError as error:
            _reset_error()  # rclpy leaves it set, and rcl then writes to the terminal
            raise RosError(
                f"{topic!r} is not a topic name: write parts of letters, digits and _ after one / each, "
                "none beginning with a digit"
            ) from error
        except RuntimeError as error:
            raise RosError(f"{topic}: {_reason(error)}") from error

    def _ask(self, question: Any, *arguments: str) -> Any:
        try:
            return question(self._node, *arguments, False)  # names as ROS has them, not DDS
        except RuntimeError as error:
            raise RosError(f"the ROS graph cannot be read: {_reason(error)}") from error

    def _others(self, infos: list[dict[str, Any]]) -> list[Endpoint]:
        return [end for info in infos if (end := endpoint_of(info)).node != self._name]


class Reader:
    """A raw subscription, of the thread that takes from it.

    Attributes:
        handle: rclpy's.
        address: of the rcl subscription; names the reader in `Participant.wait`.
        topic: its resolved name.
        lost: messages missing between those taken, and before those of a publisher that came after the subscription.
    """

    def __init__(self, handle: Any, buffer: _Buffer, earlier: frozenset[bytes] | None) -> None:
        """Begin to count.

        Args:
            handle: rclpy's.
            buffer: that messages are taken into, shared by the readers of a thread.
            earlier: the publishers that were there before; None: what comes first is history, and none is new.
        """
        self.handle = handle
        self.address: int = handle.pointer
        self.topic: str = handle.get_topic_name()
        self.lost = 0
        self._buffer = buffer
        self._info = ctypes.create_string_buffer(_INFO.size)
        self._last: dict[bytes, int] = {}  # newest sequence number by publisher
        self._earlier = earlier
        self._made_at = time.monotonic()

    def take(self, limit: int, skip: Collection[bytes]) -> list[RawMessage]:
        """Take up to `limit` messages, leaving out those of the publishers with the gids in `skip`.

        Raises:
            RosError: rcl failed.
        """
        address, buffer, info, last = self.address, self._buffer, self._info, self._last
        buffer_reference, unpack, copy = ctypes.byref(buffer), _INFO.unpack, ctypes.string_at
        taken = []
        for _ in range(limit):
            code = _take(address, buffer_reference, info, None)
            if code:
                if code == _TAKE_FAILED:
                    break
                _reset_error()
                raise RosError(f"{self.topic}: a message could not be taken (rcl error {code})")
            _, stamp, number, _, _, gid, _ = unpack(info)
            if gid in skip:
                continue
            if number > _LAST_NUMBER:
                number = 0  # RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED
            previous = last.get(gid)
            if previous is None:
                previous = 0 if self._is_newcomer(gid) else number
                self._forget_oldest()
            if number > previous + 1:
                self.lost += number - previous - 1
            last[gid] = number
            taken.append(RawMessage(copy(buffer.data, buffer.length), stamp, gid, number))
        return taken

    def close(self) -> None:
        """Free it."""
        self.handle.destroy_when_not_in_use()

    def _is_newcomer(self, gid: bytes) -> bool:
        """Whether a publisher came after the subscription, which so should have had its first message."""
        if self._earlier is None or gid in self._earlier:
            return False
        return time.monotonic() - self._made_at > _DISCOVERED_WITHIN

    def _forget_oldest(self) -> None:
        """Make room for another publisher: short-lived ones must not fill the memory."""
        if len(self._last) >= _PUBLISHERS_REMEMBERED:
            del self._last[next(iter(self._last))]
            self._earlier = None  # from now on, one that seems new may be one that was forgotten


class Writer:
    """A raw publisher, for any thread: rclpy publishes with the GIL held, so it is never freed under a `publish`.

    Attributes:
        topic: its resolved name.
        gid: what messages taken say of their publisher.
    """

    def __init__(self, handle: Any) -> None:
        self.topic: str = handle.get_topic_name()
        gid = _Gid()
        _gid_of_publisher(_publisher_handle(handle.pointer), gid)
        self.gid = bytes(gid.value)
        self._handle = handle
        self._publish = handle.publish_raw
        self._closed = False

    def publish(self, payload: bytes) -> None:
        """Publish one serialized message.

        Raises:
            RosError: it is closed, the payload is no message, or the middleware refused it.
        """
        if len(payload) < 4:
            raise RosError(f"{self.topic}: a serialized message has at least 4 bytes, not {len(payload)}")
        try:
            self._publish(payload)
        except RuntimeError as error:
            reason = "the publisher is closed" if self._closed else _reason(error)
            raise RosError(f"{self.topic}: {reason}") from error

    @property
    def matched(self) -> int:
        """How many subscriptions match it, our own node's too; 0 once closed."""
        try:
            count: int = self._handle.get_subscription_count()
        except RuntimeError:
            return 0
        return count

    def close(self) -> None:
        """Free it. May be called twice."""
        self._closed = True
        self._handle.destroy_when_not_in_use()


def _reason(error: Exception) -> str:
    """An rcl error without the places in its source code."""
    return str(error).partition(", at ")[0]
