"""Message and service classes for raw use, also of types that are not installed.

Raw CDR needs no layout. rmw_fastrtps_cpp asks a type support for its name, its hash, a bound on its size and an
introspection handle, all while an endpoint is created; it calls the functions that depend on the layout only for
ordinary messages. So a type support for a bare name and hash is std_msgs/String's (unbounded, no key) with these.
Layout of its inside: rosidl_typesupport_fastrtps_cpp/message_type_support.h (ROS 2 Jazzy). Other middlewares need the
layout, and other distributions lay the struct out otherwise: there the type's package must be installed.

A service's type support is a struct with the type supports of its request and response. rcl has no function that takes
or sends a call serialized: it has the middleware take and send a ROS message, and rmw_fastrtps_cpp calls that message's
type support to write it to a Cdr, or to read it from one (fastcdr). So a type support that copies bytes carries any
type.
In the message's place is a Python object:

- To send, a callable that writes the payload to the Cdr that it is called with (`outgoing`). The middleware calls it
  with its writer locked. If Python gave up the GIL there, a thread that has it and wants the writer would wait for
  ever. So not one Python instruction may run: `operator.call`, `functools.partial` and what they call are C.
- To take, a list that the payload is put into. The middleware has nothing locked then.

Where that cannot be, with another middleware or another version of it, the service's package has to be installed, and
rclpy converts the messages.
Layouts: rosidl_runtime_c/service_type_support_struct.h, rosidl_typesupport_fastrtps_cpp/service_type_support.h.
"""

from __future__ import annotations

import ctypes
import operator
import re
import struct
import threading
from functools import cache, lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

from rclpy.utilities import get_rmw_implementation_identifier

from rsb_bridge.model.names import split_type_name
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.ros_interface import RosError, RosProblem
from rsb_bridge.ros.typesupport import (
    FIND,
    GET_HASH,
    HASH_PATTERN,
    HASH_PREFIX,
    ServiceTypeSupport,
    TypeHash,
    TypeSupport,
    capsule_of,
    hash_of,
    installed_class,
    installed_service,
    service_hash_of,
    type_support_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable

FASTRTPS = b"rosidl_typesupport_fastrtps_c"
_INTROSPECTION = b"rosidl_typesupport_introspection_c"
_JAZZY = "7.1."  # rclpy's version; ROS_DISTRO is set only where a setup file was sourced


class MessageCallbacks(ctypes.Structure):
    """A message_type_support_callbacks_t."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("serialize", ctypes.c_void_p),
        ("deserialize", ctypes.c_void_p),
        ("serialized_size", ctypes.c_void_p),
        ("max_serialized_size", ctypes.c_void_p),
        ("key_callbacks", ctypes.c_void_p),
    )


_Struct = TypeVar("_Struct", bound=ctypes.Structure)


def borrow_type(type_name: str, type_hash: str) -> BorrowedType:
    """Return the class for raw endpoints of a type: the installed one, else one made here.

    Args:
        type_name: ``pkg/msg/Name``.
        type_hash: ``RIHS01_...``, or empty where it is not known: then the type must be installed.

    Raises:
        RosError: the type is installed with another hash, or it is not installed and has to be.
    """
    try:
        installed = installed_class(type_name)
    except ValueError as error:
        raise RosError(str(error)) from None
    if installed is None:
        _check_named(type_name, type_hash)
        return named_types.borrow(type_name, type_hash)
    check_same(type_name, hash_of(installed), type_hash, "message")  # which loads the type support too
    return BorrowedType(installed, nothing)


class UnusableType(Wording):
    """The reasons why a type of a message or service can't be used here."""

    ANOTHER_VERSION = (
        "{type_name} is another {kind} here ({here}) than there ({there}): install the same version of {package} on "
        "both sides"
    )
    HASH_UNKNOWN = "{type_name} is not installed and no {source} tells its type hash: {remedy}"
    INVALID_HASH = "{type_hash!r} is not a type hash: {prefix} and 64 hex digits"
    INVALID_SERVICE_HASH = "{type_hash!r} is not a service's hash: two of {prefix} and 64 hex digits, with + between"
    NEEDS_FASTRTPS = (
        "{type_name} is not installed, and only rmw_fastrtps_cpp on ROS 2 Jazzy carries messages of such types: "
        "{remedy}"
    )
    ANOTHER_MIDDLEWARE = "only rmw_fastrtps_cpp on ROS 2 Jazzy carries calls of such types"
    ANOTHER_FAST_CDR = "this version of Fast CDR does not carry calls of such types"
    CALLS_NOT_CARRIED = "{type_name} is not installed, and {reason}: {remedy}"
    NOT_A_SERVICE = "{type_name!r} is not a service type: write it as package/srv/Name"
    NO_STRINGS = "std_msgs is not installed: install ros-jazzy-std-msgs"
    FOREIGN_ENCAPSULATION = "a message that is encapsulated as {encapsulation} cannot be sent in a call, only 0001 can"
    REMEDY = "install {package}, or source the workspace that has it"


def check_same(type_name: str, here: str, there: str, what: str) -> None:
    """Refuse a type that is installed with another hash.

    Raises:
        RosError: `there` is neither empty nor `here`.
    """
    if there not in {"", here}:
        raise RosError(
            UnusableType.ANOTHER_VERSION(
                type_name=type_name, kind=what, here=here, there=there, package=type_name.partition("/")[0]
            )
        )


def remedy(type_name: str) -> str:
    """Return an instruction to install a type."""
    package = split_type_name(type_name)[0]
    return UnusableType.REMEDY(package=f"ros-jazzy-{package.replace('_', '-')}")


def layouts_known() -> bool:
    """Whether type supports of this middleware are laid out as this module knows them."""
    return get_rmw_implementation_identifier() == "rmw_fastrtps_cpp" and _is_jazzy()


@cache
def _is_jazzy() -> bool:
    from importlib.metadata import version  # noqa: PLC0415  2 MB, which installed messages do without

    return version("rclpy").startswith(_JAZZY)


def _check_named(type_name: str, type_hash: str) -> None:
    to_do = remedy(type_name)
    if not type_hash:
        raise RosError(UnusableType.HASH_UNKNOWN(type_name=type_name, source="publisher", remedy=to_do))
    if not re.fullmatch(HASH_PATTERN, type_hash):
        raise RosError(UnusableType.INVALID_HASH(type_hash=type_hash, prefix=HASH_PREFIX))
    if not layouts_known():
        raise RosError(UnusableType.NEEDS_FASTRTPS(type_name=type_name, remedy=to_do))


class BorrowedType(NamedTuple):
    """A message or service class that an endpoint uses.

    Attributes:
        interface: for rclpy.
        give_back: to be called once, when the endpoint is gone.
    """

    interface: type
    give_back: Callable[[], None]


class NamedType(Protocol):
    """A type support under a name and a hash that can be changed while no endpoint uses it.

    Attributes:
        interface: the class by which rclpy finds it.
    """

    interface: type

    def rename(self, type_name: str, type_hash: str) -> None:
        """Be another type."""
        ...


class NamedTypes:
    """Types known by name and hash alone, each for as long as an endpoint uses it.

    One that nobody uses any more is renamed for the next type. None is ever freed: should the middleware keep a pointer
    to one, it points at valid memory.

    Attributes:
        made: how many there are, used or not.
    """

    def __init__(self, make: Callable[[], NamedType] | None = None) -> None:
        """Begin without types.

        Args:
            make: makes a type, or None for message types.
        """
        self.made = 0
        self._make = make or NamedMessage
        self._lock = threading.Lock()
        self._used: dict[tuple[str, str], _Used] = {}
        self._free: list[NamedType] = []

    @property
    def used(self) -> int:
        """How many types endpoints use now."""
        return len(self._used)

    def borrow(self, type_name: str, type_hash: str) -> BorrowedType:
        """Return the class of a type; endpoints of one type share it."""
        key = (type_name, type_hash)
        with self._lock:
            used = self._used.get(key)
            if used is None:
                used = _Used(self._free.pop() if self._free else self._another())
                used.named.rename(type_name, type_hash)
                self._used[key] = used
            used.users += 1
        return BorrowedType(used.named.interface, partial(self._give_back, key))

    def _another(self) -> NamedType:
        self.made += 1
        return self._make()

    def _give_back(self, key: tuple[str, str]) -> None:
        with self._lock:
            used = self._used[key]
            used.users -= 1
            if not used.users:
                self._free.append(self._used.pop(key).named)


class _Used:
    """A type, and the number of endpoints that use it."""

    def __init__(self, named: NamedType) -> None:
        self.named = named
        self.users = 0


class NamedSupport:
    """A message's type support under a name and a hash that can be changed.

    Attributes:
        type_support: for rcl and for the middleware.
        callbacks: which the middleware calls.
    """

    def __init__(self) -> None:
        string = installed_class("std_msgs/msg/String")
        if string is None:
            raise RosError(UnusableType.NO_STRINGS())
        original = type_support_of(string)
        find_in_string = FIND(original.find)
        fastrtps = find_in_string(ctypes.addressof(original), FASTRTPS)
        introspection = find_in_string(ctypes.addressof(original), _INTROSPECTION)

        type_support = self.type_support = _copy(TypeSupport.from_address(fastrtps))
        callbacks = self.callbacks = _copy(MessageCallbacks.from_address(type_support.data))
        type_hash = self._hash = TypeHash(version=1)
        answers = {FASTRTPS: ctypes.addressof(type_support), _INTROSPECTION: introspection}
        find = FIND(lambda _, identifier: answers.get(identifier))
        get_hash = GET_HASH(lambda _: ctypes.addressof(type_hash))
        type_support.data = ctypes.addressof(callbacks)
        type_support.find = ctypes.cast(find, ctypes.c_void_p).value
        type_support.get_hash = ctypes.cast(get_hash, ctypes.c_void_p).value
        self._keep_alive = (find, get_hash)

    def rename(self, type_name: str, type_hash: str) -> None:
        """Be another message."""
        package, kind, name = split_type_name(type_name)
        self.callbacks.namespace, self.callbacks.name = f"{package}::{kind}".encode(), name.encode()
        self._hash.value[:] = bytes.fromhex(type_hash.removeprefix(HASH_PREFIX))


class NamedMessage:
    """A message type; see `NamedType`."""

    def __init__(self) -> None:
        self._support = NamedSupport()
        # What rclpy looks for in a message class's metaclass. It converts no message: they are raw.
        metaclass = type(
            "AnyType",
            (type,),
            {
                "_TYPE_SUPPORT": capsule_of(self._support.type_support),
                "_CREATE_ROS_MESSAGE": None,
                "_CONVERT_FROM_PY": None,
                "_CONVERT_TO_PY": None,
                "_DESTROY_ROS_MESSAGE": None,
            },
        )
        self.interface: type = metaclass("Any", (), {})
        self.rename = self._support.rename


named_types = NamedTypes()
"""The process's types: the middleware identifies a type by its name for all nodes."""


def nothing() -> None:
    """An installed type is not given back."""


def _copy(struct: _Struct) -> _Struct:
    return type(struct).from_buffer_copy(struct)


_HASHES = re.compile(rf"({HASH_PATTERN})\+({HASH_PATTERN})")


class BorrowedService(NamedTuple):
    """A service class that an endpoint uses.

    Attributes:
        type: its class, and how to give it back.
        raw: calls are carried as bytes; else as the installed class's messages.
    """

    type: BorrowedType
    raw: bool


def borrow_service(type_name: str, type_hash: str) -> BorrowedService:
    """Return the class for a service's endpoints.

    Args:
        type_name: ``pkg/srv/Name``, or ``pkg/action/Name_SendGoal`` and the like.
        type_hash: as `rsb_bridge.ros.ros_interface.RosInterface.servers` gives it, or empty where it is not known:
            then the type must be installed.

    Raises:
        RosError: the type is installed with another hash, or it is not installed and has to be.
    """
    try:
        installed = installed_service(type_name)
        kind = split_type_name(type_name)[1]
    except ValueError:
        kind, installed = "", None
    if kind not in {"srv", "action"}:
        raise RosError(UnusableType.NOT_A_SERVICE(type_name=type_name))
    if installed is not None:
        here = service_hash_of(installed)
        check_same(type_name, here, type_hash, "service")
        type_hash = here
    reason = why_not_raw()
    if installed is not None and reason:
        return BorrowedService(BorrowedType(installed, nothing), raw=False)
    if not type_hash:
        raise RosError(UnusableType.HASH_UNKNOWN(type_name=type_name, source="node", remedy=remedy(type_name)))
    if not _HASHES.fullmatch(type_hash):
        raise RosError(UnusableType.INVALID_SERVICE_HASH(type_hash=type_hash, prefix=HASH_PREFIX))
    if reason:
        raise RosError(UnusableType.CALLS_NOT_CARRIED(type_name=type_name, reason=reason, remedy=remedy(type_name)))
    return BorrowedService(named_services.borrow(type_name, type_hash), raw=True)


def why_not_raw() -> str:
    """Return the reason why calls of types that are not installed cannot be carried here, or an empty string."""
    if not layouts_known():
        return UnusableType.ANOTHER_MIDDLEWARE()
    if not _copies_calls():
        return UnusableType.ANOTHER_FAST_CDR()
    return ""


class _Callbacks(ctypes.Structure):
    """A service_type_support_callbacks_t."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("request", ctypes.c_void_p),
        ("response", ctypes.c_void_p),
    )


class NamedService:
    """A service type; see `rsb_bridge.ros.raw_types.NamedType`."""

    def __init__(self) -> None:
        self._parts = request, response = NamedSupport(), NamedSupport()
        for part in self._parts:
            part.callbacks.serialize = ctypes.cast(SERIALIZE, ctypes.c_void_p).value
            part.callbacks.deserialize = ctypes.cast(DESERIALIZE, ctypes.c_void_p).value
            part.callbacks.serialized_size = ctypes.cast(SIZE, ctypes.c_void_p).value
        callbacks = self._callbacks = _Callbacks(
            request=ctypes.addressof(request.type_support), response=ctypes.addressof(response.type_support)
        )
        # rcl files what it makes of the hash and description of a type under that hash; the request's will do for it.
        like = request.type_support
        type_support = self._type_support = ServiceTypeSupport(
            identifier=FASTRTPS,
            data=ctypes.addressof(callbacks),
            request=ctypes.pointer(request.type_support),
            response=ctypes.pointer(response.type_support),
            get_hash=like.get_hash,
            get_description=like.get_description,
            get_description_sources=like.get_description_sources,
        )
        answers = {FASTRTPS: ctypes.addressof(type_support)}
        find = FIND(lambda _, identifier: answers.get(identifier))
        type_support.find = ctypes.cast(find, ctypes.c_void_p).value
        self._keep_alive = find
        metaclass = type("AnyType", (type,), {"_TYPE_SUPPORT": capsule_of(type_support)})
        self.interface: type = metaclass("AnyService", (), {})

    def rename(self, type_name: str, type_hash: str) -> None:
        """Be another service."""
        package, kind, name = split_type_name(type_name)
        self._callbacks.namespace, self._callbacks.name = f"{package}::{kind}".encode(), name.encode()
        for part, ending, each in zip(self._parts, ("_Request", "_Response"), type_hash.split("+"), strict=True):
            part.rename(type_name + ending, each)


named_services = NamedTypes(NamedService)
"""The process's."""


_HEADER = 4
"""bytes: the encapsulation before the message, which the middleware writes itself."""
_WRITTEN = b"\0\1"
"""How the encapsulation begins that it writes: CDR, little endian."""
_LIBRARY = "libfastcdr.so.2"
_SPACE = "_ZN8eprosima7fastcdr"
_WORD = struct.Struct("@P")
_word_at = ctypes.c_size_t.from_address
_ROOM = 1024
"""bytes that a Cdr certainly fits in; it takes some 200 in fastcdr 2.2.5."""

_address_of = ctypes.pythonapi.PyBytes_AsString
_address_of.argtypes, _address_of.restype = [ctypes.py_object], ctypes.c_void_p


class _Cdr(NamedTuple):
    """A Cdr seen from outside: it does not export how many bytes it reads, so its memory is looked at.

    Attributes:
        buffer: place in a Cdr of the address of its FastBuffer.
        data: place in a FastBuffer of the address of the bytes.
        size: place in a FastBuffer of their number.
        write: C function that appends ``length`` bytes at ``data`` to ``cdr``.
    """

    buffer: int
    data: int
    size: int
    write: Callable[..., int]


def _copies_calls() -> bool:
    """Whether bytes get in and out of this version of fastcdr."""
    return _cdr() is not None


def outgoing(payload: bytes) -> object:
    """Return an object to send in the message's place.

    The caller passes its address (`id`), and keeps it and the payload alive until the middleware has returned.

    Raises:
        RosError: the payload is too short or of another byte order.
    """
    if len(payload) < _HEADER:
        raise RosError(RosProblem.MESSAGE_TOO_SHORT(length=len(payload)))
    if not payload.startswith(_WRITTEN):
        raise RosError(UnusableType.FOREIGN_ENCAPSULATION(encapsulation=payload[:2].hex()))
    cdr = _cdr()
    assert cdr is not None
    length = len(payload) - _HEADER
    writing = partial(cdr.write, data=_address_of(payload) + _HEADER, length=length)
    vars(writing)["size"] = length
    return writing


def _deserialize(address: int, taken: list[bytes]) -> bool:
    """Put the payload that a Cdr reads into a list."""
    cdr = _cdr()
    assert cdr is not None
    buffer = _word_at(address + cdr.buffer).value
    data, size = _word_at(buffer + cdr.data).value, _word_at(buffer + cdr.size).value
    taken.append(ctypes.string_at(data, size))
    return True


SERIALIZE = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)(operator.call)
DESERIALIZE = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.py_object)(_deserialize)
SIZE = ctypes.PYFUNCTYPE(ctypes.c_uint32, ctypes.py_object)(operator.attrgetter("size"))
"""The callbacks of a type support (rosidl_typesupport_fastrtps_cpp/message_type_support.h)."""


@lru_cache(1)
def _cdr() -> _Cdr | None:
    """Find out the layout of a Cdr by making one; return None if it is not the expected one."""
    try:
        library = ctypes.PyDLL(_LIBRARY)  # the middleware has loaded it
        new_buffer = library[f"{_SPACE}10FastBufferC1EPcm"]
        new_cdr = library[f"{_SPACE}3CdrC1ERNS0_10FastBufferENS1_10EndiannessENS0_10CdrVersionE"]
        bytes_of = library[f"{_SPACE}3Cdr18get_buffer_pointerEv"]
        write = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)(
            (f"{_SPACE}3Cdr15serialize_arrayEPKcm", library), ((1, "cdr"), (1, "data"), (1, "length"))
        )
    except (OSError, AttributeError):
        return None
    new_buffer.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t]
    new_cdr.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_int]
    bytes_of.argtypes, bytes_of.restype = [ctypes.c_void_p], ctypes.c_void_p

    content, buffer, cdr = (ctypes.create_string_buffer(size) for size in (77, _ROOM, _ROOM))
    new_buffer(buffer, content, len(content))
    new_cdr(cdr, buffer, 1, 1)  # little endian, XCDR version 1
    write(cdr, b"here", 4)
    if bytes_of(cdr) != ctypes.addressof(content) or content.raw[:5] != b"here\0":
        return None
    try:
        return _Cdr(
            buffer=_place(cdr, ctypes.addressof(buffer)),
            data=_place(buffer, ctypes.addressof(content)),
            size=_place(buffer, len(content)),
            write=write,
        )
    except LookupError:
        return None


def _place(memory: ctypes.Array[ctypes.c_char], word: int) -> int:
    """Return the place of a word that must occur once.

    Raises:
        LookupError: the word is missing or occurs several times.
    """
    found = [place for place in range(0, _ROOM, _WORD.size) if _WORD.unpack_from(memory, place) == (word,)]
    if len(found) != 1:
        raise LookupError(word)
    return found[0]
