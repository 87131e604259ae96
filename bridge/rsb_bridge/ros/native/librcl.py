"""ROS's C client library, rcl, as ctypes calls it: functions, the structs that they take, and serialization.

Structs: rcl/wait.h, rmw/types.h, rcutils/types/uint8_array.h, rcutils/allocator.h (the same in ROS 2 Jazzy and Kilted).
"""

from __future__ import annotations

import ctypes
import struct
from typing import TYPE_CHECKING, Any, Final

from rclpy.type_support import check_for_type_support

from rsb_bridge.ros.distribution import described
from rsb_bridge.ros.native.typesupport import pointer_in, type_support_of
from rsb_bridge.ros.ros_interface import RosError, RosProblem

if TYPE_CHECKING:
    from collections.abc import Callable

# PyDLL keeps the GIL: the calls take about 1 µs, and giving it up each time would cost a whole switch interval whenever
# another thread is busy. rclpy has loaded the libraries; librcl's handle also finds what it depends on.
_librcl = ctypes.PyDLL("librcl.so")
_librcl_without_gil = ctypes.CDLL("librcl.so")
"""For long calls, such as copies of large messages: other threads run meanwhile."""


def function(name: str, *arguments: Any, returns: Any = ctypes.c_int, library: ctypes.CDLL = _librcl) -> Any:
    """Return a function of rcl or of a library that it depends on, or a function that raises if it is missing."""
    try:
        function = library[name]
    except AttributeError:

        def missing(*_arguments: object) -> None:
            raise RosError(RosProblem.LACKS(distribution=described(), name=name))

        return missing
    function.argtypes, function.restype = list(arguments), returns
    return function


_POINTER = ctypes.c_void_p
reset_error = function("rcutils_reset_error", returns=None)
"""Forgets the last error. If one stays, rcl writes to the terminal at the next one, into the console's screen."""


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


_default_allocator = function("rcutils_get_default_allocator", returns=_Allocator)
_buffer_init = function("rcutils_uint8_array_init", ctypes.POINTER(Buffer), ctypes.c_size_t, ctypes.POINTER(_Allocator))
_buffer_fini = function("rcutils_uint8_array_fini", ctypes.POINTER(Buffer))
_serialize = function("rmw_serialize", _POINTER, _POINTER, ctypes.POINTER(Buffer))

_CREATE = ctypes.PYFUNCTYPE(ctypes.c_void_p)
_CONVERT = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)
_DESTROY = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)
"""What a message class's metaclass has, in capsules: makes its C struct, fills it from a Python message, frees it."""


def serialize_message(message: Any) -> bytes:
    """Serialize a message as rclpy does: CDR with its encapsulation header.

    Unlike rclpy, leave no remains of other memory, neither in the padding, up to 7 bytes before a number, nor behind
    the message, where `rmw_serialize` of rmw_fastrtps_cpp counts bytes that its empty sequences do not have.

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
        code = _serialize(in_c, type_support, buffer)  # makes the buffer large enough
        written = []
        for fill in (0xFF, 0):
            if not code:
                ctypes.memset(buffer.data, fill, buffer.capacity)
                code = _serialize(in_c, type_support, buffer)
                written.append(ctypes.string_at(buffer.data, buffer.length))
        if code:
            reset_error()
            raise RosError(f"a {type(message).__name__} could not be serialized (rmw error {code})")
        return _message_of(*written)
    finally:
        buffer.free()
        _DESTROY(pointer_in(functions._DESTROY_ROS_MESSAGE))(in_c)


def _message_of(over_ones: bytes, over_zeros: bytes) -> bytes:
    """Return the message, without the unwritten end in which the copies differ, in whole words as DDS sends it."""
    end = len(over_zeros)
    while over_ones[end - 1] != over_zeros[end - 1]:
        end -= 1
    return over_zeros[: end + -end % 4]


_COPIED_BELOW = 32 * 1024
"""Bytes up to which a copy costs less than a call from C."""

_new_bytes = ctypes.pythonapi.PyBytes_FromStringAndSize
_new_bytes.argtypes, _new_bytes.restype = [ctypes.c_void_p, ctypes.c_ssize_t], ctypes.py_object
address_of = ctypes.pythonapi.PyBytes_AsString
address_of.argtypes, address_of.restype = [ctypes.py_object], ctypes.c_void_p
_REALLOCATE = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
_DEALLOCATE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)


class TakeBuffer(Buffer):
    """Takes one message at a time, each large one into bytes of exactly its size, so that it is not copied once more.

    rcl asks the allocator for more memory where a message is larger than the buffer, and says how large it is; what it
    gets then is the content of a new bytes object. The buffer is shared by all that take on one thread.

    Attributes:
        large: the message that was just taken, if it is large.
        small: the memory of one that is not.
    """

    def __init__(self) -> None:
        super().__init__()
        self.large: list[bytes] = []
        self._memory = ctypes.create_string_buffer(_COPIED_BELOW)
        self._start = ctypes.addressof(self._memory)
        self.small = memoryview(self._memory).cast("B")
        self._callbacks = _REALLOCATE(_growing(self.large)), _DEALLOCATE(_keep)
        self.allocator.reallocate, self.allocator.deallocate = (
            ctypes.cast(each, ctypes.c_void_p) for each in self._callbacks
        )
        self._shrink()

    def taken(self) -> bytes:
        """Return the message that was just taken, if it is in `large`; to be asked once."""
        payload = self.large.pop()
        self._shrink()
        return payload

    def discard(self) -> None:
        """Forget the message that was just taken."""
        if self.large:
            self.large.clear()
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
            # An exception cannot leave a callback. With a null pointer, rcl reports that there is no memory.
            return None
        large[:] = [payload]
        address: int = address_of(payload)
        return address

    return grow


def _keep(_data: int | None, _state: int | None) -> None:
    """Replace `free`: the memory is Python's."""


# --- what is waited for


class WaitSetHead(ctypes.Structure):
    """The first fields of a rcl_wait_set_t. After a wait, untriggered entries are NULL."""

    _fields_ = (
        ("subscriptions", _POINTER),
        ("subscription_count", ctypes.c_size_t),
        ("guard_conditions", ctypes.POINTER(_POINTER)),
        ("guard_condition_count", ctypes.c_size_t),
    )


graph_guard_condition = function("rcl_node_get_graph_guard_condition", _POINTER, returns=_POINTER)
add_guard_condition = function("rcl_wait_set_add_guard_condition", _POINTER, _POINTER, ctypes.POINTER(ctypes.c_size_t))

ON_ARRIVAL: Final = {
    kind: function(name, _POINTER, _POINTER, _POINTER)
    for kind, name in (
        ("subscription", "rcl_subscription_set_on_new_message_callback"),
        ("service", "rcl_service_set_on_new_request_callback"),
        ("client", "rcl_client_set_on_new_response_callback"),
    )
}
"""Have DDS call a C function on its threads when something comes to an endpoint, with a pointer and a count. Given the
endpoint's address, the function and the pointer, or None twice: the function has returned, and is called no more."""
EVENTFD_WRITE: Final = ctypes.cast(ctypes.CDLL(None).eventfd_write, _POINTER)
"""libc's `eventfd_write` is such a function, where a pointer and a count are passed as it takes a descriptor and 64
bits: on 64-bit computers."""

# --- messages

feature_supported = function("rmw_feature_supported", ctypes.c_int, returns=ctypes.c_bool)
PUBLICATION_NUMBERS: Final = 0
"""RMW_FEATURE_MESSAGE_INFO_PUBLICATION_SEQUENCE_NUMBER: messages have their publisher's number."""
TAKE_FAILED: Final = 401
"""RCL_RET_SUBSCRIPTION_TAKE_FAILED: there is no message."""
MESSAGE_INFO: Final = struct.Struct("@qqQQP16s")
"""The first fields of a rmw_message_info_t: source and reception time in ns, publication and reception number, the
publisher's gid (its middleware's name and 16 bytes)."""
INFO_ROOM: Final = 128
"""Bytes for a rmw_message_info_t. Until Humble, 8 more bytes of the gid follow."""


class Gid(ctypes.Structure):
    """A rmw_gid_t, with room for the 24 bytes that it has until Humble; the first 16 count."""

    _fields_ = (("middleware", ctypes.c_char_p), ("value", ctypes.c_uint8 * 16), ("more", ctypes.c_uint8 * 8))


_TAKE = "rcl_take_serialized_message", _POINTER, _POINTER, _POINTER, _POINTER
_PUBLISH = "rcl_publish_serialized_message", _POINTER, _POINTER, _POINTER
take_message, take_long_message = function(*_TAKE), function(*_TAKE, library=_librcl_without_gil)
publish_message, publish_long_message = function(*_PUBLISH), function(*_PUBLISH, library=_librcl_without_gil)
wait_for_all_acked = function("rcl_publisher_wait_for_all_acked", _POINTER, ctypes.c_int64)
rmw_publisher = function("rcl_publisher_get_rmw_handle", _POINTER, returns=_POINTER)
rmw_subscription = function("rcl_subscription_get_rmw_handle", _POINTER, returns=_POINTER)
_gid_of_publisher = function("rmw_get_gid_for_publisher", _POINTER, ctypes.POINTER(Gid))


def gid_of(publisher: int) -> bytes:
    """Return what messages say of their publisher, given its address."""
    gid = Gid()
    _gid_of_publisher(rmw_publisher(publisher), gid)
    return bytes(gid.value)


# --- calls

NO_REQUEST: Final = 601
"""RCL_RET_SERVICE_TAKE_FAILED."""
NO_RESPONSE: Final = 501
"""RCL_RET_CLIENT_TAKE_FAILED."""
NOT_MATCHED: Final = 2
"""RCL_RET_TIMEOUT."""
CALLER: Final = struct.Struct("@16sq")
"""A rmw_request_id_t: a GUID, and the number of the caller's request."""
CALL_INFO: Final = struct.Struct("@qq16sq")
"""A rmw_service_info_t: source and reception time in ns, and whose call it is."""

take_request = function("rcl_take_request_with_info", _POINTER, _POINTER, _POINTER)
take_response = function("rcl_take_response_with_info", _POINTER, _POINTER, _POINTER)
send_request = function("rcl_send_request", _POINTER, _POINTER, ctypes.POINTER(ctypes.c_int64))
send_response = function("rcl_send_response", _POINTER, _POINTER, _POINTER)
