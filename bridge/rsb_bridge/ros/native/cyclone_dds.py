"""The publisher of a message, where Cyclone DDS is the middleware (rmw_cyclonedds_cpp).

The graph, and a bridge's announcements, know a publisher by its GUID. A message taken tells its instance handle, which
means something in this process only (`message_info_from_sample_info` in rmw_cyclonedds_cpp/src/rmw_node.cpp). So does
rmw_get_gid_for_publisher. Cyclone DDS itself tells which GUID that is.

Structs: rmw/types.h (`rmw_publisher_t` and `rmw_subscription_t` begin alike), `CddsEntity` of rmw_node.cpp, and
dds/ddsc/dds_public_impl.h and dds_builtin_topics.h of Cyclone DDS 0.10.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from typing import TYPE_CHECKING, Any, Final

from rclpy.utilities import get_rmw_implementation_identifier

from rsb_bridge.ros.distribution import described
from rsb_bridge.ros.native.librcl import rmw_publisher, rmw_subscription
from rsb_bridge.ros.ros_interface import RosError, RosProblem

if TYPE_CHECKING:
    from collections.abc import Callable

CYCLONE_DDS: Final = "rmw_cyclonedds_cpp"
_GUID_LENGTH = 16
_PUBLISHERS_REMEMBERED = 1024
"""A round figure, as of `topic_endpoints`: one that is forgotten is asked for again."""


class _Endpoint(ctypes.Structure):
    """A rmw_publisher_t or rmw_subscription_t. What its data points to begins with a dds_entity_t."""

    _fields_ = (("identifier", ctypes.c_char_p), ("data", ctypes.POINTER(ctypes.c_int32)))


@cache
def is_used() -> bool:
    """Whether ROS uses Cyclone DDS in this process."""
    return bool(get_rmw_implementation_identifier() == CYCLONE_DDS)


def guid_of_publisher(publisher: int) -> bytes:
    """Return the GUID of a publisher of ours, given its address.

    Raises:
        RosError: Cyclone DDS does not tell it.
    """
    guid = ctypes.create_string_buffer(_GUID_LENGTH)
    if _library().get_guid(_entity(rmw_publisher(publisher)), guid):
        raise RosError(RosProblem.LACKS(distribution=described(), name="dds_get_guid"))
    return guid.raw


class SubscriptionPublishers:
    """The publishers of one subscription. Belongs to the thread that takes from it."""

    def __init__(self, subscription: int) -> None:
        self._entity = _entity(rmw_subscription(subscription))
        self._guids: dict[bytes, bytes] = {}

    def guid_of(self, told: bytes) -> bytes:
        """Return the GUID of a message's publisher, or `told` if it has gone since.

        Args:
            told: 16 bytes that the message's information has: the handle, and zeros.
        """
        guid = self._guids.get(told)
        if guid is None:
            guid = self._asked(int.from_bytes(told[:8], sys.byteorder))
            if not guid:
                return told
            if len(self._guids) >= _PUBLISHERS_REMEMBERED:
                del self._guids[next(iter(self._guids))]
            self._guids[told] = guid
        return guid

    def _asked(self, handle: int) -> bytes:
        library = _library()
        found = library.matched_publication(self._entity, handle)
        if not found:
            return b""
        try:
            return ctypes.string_at(found, _GUID_LENGTH)  # a dds_builtintopic_endpoint_t begins with its key
        finally:
            library.free_endpoint(found)


class _Library:
    """Cyclone DDS's functions, which the handle of the middleware's library finds too."""

    def __init__(self) -> None:
        try:
            library = ctypes.PyDLL(f"lib{CYCLONE_DDS}.so")
        except OSError as error:
            raise RosError(RosProblem.LACKS(distribution=described(), name=str(error))) from error
        self.get_guid = _function(library, "dds_get_guid", ctypes.c_int32, ctypes.c_char_p)
        self.matched_publication = _function(
            library, "dds_get_matched_publication_data", ctypes.c_int32, ctypes.c_uint64, returns=ctypes.c_void_p
        )
        self.free_endpoint = _function(library, "dds_builtintopic_free_endpoint", ctypes.c_void_p, returns=None)


_library: Callable[[], _Library] = cache(_Library)


def _function(library: ctypes.PyDLL, name: str, *arguments: Any, returns: Any = ctypes.c_int) -> Any:
    try:
        function = library[name]
    except AttributeError as error:
        raise RosError(RosProblem.LACKS(distribution=described(), name=name)) from error
    function.argtypes, function.restype = list(arguments), returns
    return function


def _entity(endpoint: int) -> int:
    """Return the dds_entity_t of an endpoint of the middleware, given its address."""
    return int(_Endpoint.from_address(endpoint).data[0])
