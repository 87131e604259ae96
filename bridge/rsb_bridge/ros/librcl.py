"""ROS's C client library, rcl, as ctypes calls it: handles, buffers, serialization, QoS and endpoints.

Structs: rcutils/types/uint8_array.h, rcutils/allocator.h (ROS 2 Jazzy).
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.type_support import check_for_type_support

from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.qos import Qos, clamp_qos
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.ros.ros_interface import Endpoint, RosError
from rsb_bridge.ros.typesupport import HASH_PREFIX, pointer_in, type_support_of

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable

    from rsb_bridge.ros.raw_types import BorrowedType

# PyDLL keeps the GIL: the calls take about 1 µs, and giving it up each time would cost a whole switch interval whenever
# another thread is busy. rclpy has loaded the libraries; librcl's handle also finds what it depends on.
librcl = ctypes.PyDLL("librcl.so")
librcl_without_gil = ctypes.CDLL("librcl.so")
"""For long calls, such as copies of large messages: other threads run meanwhile."""
reset_error = librcl.rcutils_reset_error


def reason_of(error: Exception) -> str:
    """Return an rcl error without the places in its source code."""
    return str(error).partition(", at ")[0]


class Handle:
    """An endpoint of rclpy's.

    Attributes:
        rclpy: itself.
        address: of what rcl has of it.
    """

    def __init__(self, rclpy: Any, borrowed: BorrowedType, entities: threading.RLock) -> None:
        """Hold one that was just created.

        Args:
            rclpy: itself.
            borrowed: its type.
            entities: held while its participant's endpoints are created or freed.
        """
        self.rclpy = rclpy
        self.address: int = rclpy.pointer
        self._borrowed = borrowed
        self._entities = entities

    def free(self) -> None:
        """To be called once."""
        with self._entities:
            self.rclpy.destroy_when_not_in_use()
        self._borrowed.give_back()


class _Allocator(ctypes.Structure):
    """A rcutils_allocator_t."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in ("allocate", "deallocate", "reallocate", "zero", "state"))


class Serialized(ctypes.Structure):
    """A rcl_serialized_message_t."""

    _fields_ = (
        ("data", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class Buffer(Serialized):
    """One that rcl makes larger as it needs."""

    def __init__(self) -> None:
        super().__init__()
        _buffer_init(self, 0, _default_allocator())

    def free(self) -> None:
        """To be called once."""
        _buffer_fini(self)


_default_allocator = librcl.rcutils_get_default_allocator
_default_allocator.restype = _Allocator
_buffer_init = librcl.rcutils_uint8_array_init
_buffer_init.argtypes = [ctypes.POINTER(Buffer), ctypes.c_size_t, ctypes.POINTER(_Allocator)]
_buffer_fini = librcl.rcutils_uint8_array_fini
_buffer_fini.argtypes = [ctypes.POINTER(Buffer)]
_serialize = librcl.rmw_serialize
_serialize.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.POINTER(Buffer)]

_CREATE = ctypes.PYFUNCTYPE(ctypes.c_void_p)
_CONVERT = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)
_DESTROY = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)
"""What a message class's metaclass has, in capsules: makes its C struct, fills it from a Python message, frees it."""


def serialize_message(message: Any) -> bytes:
    """Serialize a message as rclpy does: CDR with its encapsulation header.

    Unlike rclpy, leave no remains of other memory in the padding, up to 7 bytes before a number: write the message
    twice, the second time over zeros.

    Raises:
        RosError: the middleware refused it.
    """
    check_for_type_support(type(message))
    functions: Any = type(type(message))
    type_support = ctypes.addressof(type_support_of(type(message)))
    in_c = _CREATE(pointer_in(functions._CREATE_ROS_MESSAGE))()
    buffer = Buffer()
    try:
        _CONVERT(pointer_in(functions._CONVERT_FROM_PY))(message, in_c)  # raises what rclpy would
        code = _serialize(in_c, type_support, buffer)
        if not code:
            ctypes.memset(buffer.data, 0, buffer.capacity)
            code = _serialize(in_c, type_support, buffer)
        if code:
            reset_error()
            raise RosError(f"a {type(message).__name__} could not be serialized (rmw error {code})")
        return ctypes.string_at(buffer.data, buffer.length)
    finally:
        buffer.free()
        _DESTROY(pointer_in(functions._DESTROY_ROS_MESSAGE))(in_c)


_COPIED_BELOW = 32 * 1024
"""Bytes up to which a copy costs less than a call from C."""

_new_bytes = ctypes.pythonapi.PyBytes_FromStringAndSize
_new_bytes.argtypes, _new_bytes.restype = [ctypes.c_void_p, ctypes.c_ssize_t], ctypes.py_object
_address_of = ctypes.pythonapi.PyBytes_AsString
_address_of.argtypes, _address_of.restype = [ctypes.py_object], ctypes.c_void_p
_REALLOCATE = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
_DEALLOCATE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)


class TakeBuffer(Buffer):
    """Takes one message at a time, each large one into bytes of exactly its size, so that it is not copied once more.

    rcl asks the allocator for more memory where a message is larger than the buffer, and says how large it is; what it
    gets then is the content of a new bytes object. The buffer is shared by all that take on one thread.
    """

    def __init__(self) -> None:
        super().__init__()
        self._large: list[bytes] = []
        self._memory = ctypes.create_string_buffer(_COPIED_BELOW)
        self._start = ctypes.addressof(self._memory)
        self._bytes = memoryview(self._memory).cast("B")
        self._callbacks = _REALLOCATE(_growing(self._large)), _DEALLOCATE(_keep)
        self.allocator.reallocate, self.allocator.deallocate = (
            ctypes.cast(each, ctypes.c_void_p) for each in self._callbacks
        )
        self._shrink()

    def taken(self) -> bytes:
        """Return the message that was just taken; to be asked once."""
        if not self._large:
            return self._bytes[: self.length].tobytes()
        payload = self._large.pop()
        self._shrink()
        return payload

    def discard(self) -> None:
        """Forget the message that was just taken."""
        if self._large:
            self._large.clear()
            self._shrink()

    def free(self) -> None:
        """Forget all. No memory of rcl's has to be freed."""
        self.discard()

    def _shrink(self) -> None:
        self.data, self.capacity = self._start, _COPIED_BELOW


def _growing(large: list[bytes]) -> Callable[[int | None, int, int | None], int | None]:
    """Return a replacement of `realloc`. It refers to no buffer, so that buffers are freed at once."""

    def grow(_data: int | None, size: int, _state: int | None) -> int | None:
        try:
            payload: bytes = _new_bytes(None, size)
        except MemoryError:
            return None
        large[:] = [payload]
        address: int = _address_of(payload)
        return address

    return grow


def _keep(_data: int | None, _state: int | None) -> None:
    """Replace `free`: the memory is Python's."""


_INFINITE = 2**63 - 1  # ns: RMW_DURATION_INFINITE
_UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"  # of an endpoint that was discovered before its node
_DEEPEST = 2**31 - 1  # messages: DDS counts a history's depth in 32 bits


def rcl_profile(qos: Qos) -> QoSProfile:
    """Return a QoS for rcl; a depth or time that it cannot count becomes the highest that it can."""
    return QoSProfile(
        reliability=ReliabilityPolicy[qos.reliability.upper()],
        durability=DurabilityPolicy[qos.durability.upper()],
        history=HistoryPolicy[qos.history.upper()],
        depth=min(max(qos.depth, 1), _DEEPEST),
        deadline=_duration(qos.deadline),
        lifespan=_duration(qos.lifespan),
    )


def _duration(seconds: float) -> Duration:
    """A peer's figure may be anything; ROS takes what fits in 63 bits."""
    return Duration(nanoseconds=int(min(_INFINITE, max(0, seconds * 1e9))))


def endpoint_of(info: dict[str, Any]) -> Endpoint:
    """An endpoint of the graph. Any DDS program may have put it there, so nothing in it is trusted."""
    type_hash, profile = info["topic_type_hash"], info["qos_profile"]
    known = info["node_name"] != _UNKNOWN_NODE
    return Endpoint(
        node=sanitize_text(f"{info['node_namespace'].rstrip('/')}/{info['node_name']}") if known else "",
        type_name=safe_type_name(info["topic_type"]),
        type_hash=f"{HASH_PREFIX}{type_hash['value'].hex()}" if type_hash["version"] == 1 else "",
        qos=clamp_qos(
            Qos(
                reliability="reliable" if profile["reliability"] == ReliabilityPolicy.RELIABLE else "best_effort",
                durability="transient_local"
                if profile["durability"] == DurabilityPolicy.TRANSIENT_LOCAL
                else "volatile",
                history="keep_all" if profile["history"] == HistoryPolicy.KEEP_ALL else "keep_last",
                depth=0,
                deadline=_seconds(profile["deadline"]),
                lifespan=_seconds(profile["lifespan"]),
            )
        ),
        gid=bytes(info["endpoint_gid"]),
    )


def safe_type_name(name: str) -> str:
    """Return a type's name from the graph, printable and of a limited length."""
    return sanitize_text(name, TEXT_LENGTH)


def _seconds(duration: Duration) -> float:
    nanoseconds: int = duration.nanoseconds
    return 0.0 if nanoseconds >= _INFINITE else nanoseconds / 1e9
