"""Profiles of single topics' writers, where Fast DDS is the middleware (rmw_fastrtps_cpp).

rmw_fastrtps gives a writer the profile that has its topic's name, or else the default one (`create_publisher` in
rmw_fastrtps_cpp/src/publisher.cpp). There is no other choice of a policy that ROS does not know. Fast DDS reads the
files of profiles once in a process; `DomainParticipantFactory::load_XML_profiles_string` adds others, which stay.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import TYPE_CHECKING, Any

from rclpy.utilities import get_rmw_implementation_identifier

if TYPE_CHECKING:
    from collections.abc import Callable

_FAST_DDS = "rmw_fastrtps_cpp"
_FACTORY = "_ZN8eprosima7fastdds3dds24DomainParticipantFactory"
"""Mangled as GCC and Clang do (Itanium C++ ABI), alike in Fast DDS 2 and 3."""


def load_profiles(xml: bytes) -> None:
    """Add profiles to those of this process, unless the middleware has none, or cannot be asked.

    A profile of a name that is there already is refused on standard error. No endpoint may be made meanwhile.
    """
    if (load := _loader()) is not None:
        load(xml)


@cache
def _loader() -> Callable[[bytes], None] | None:
    if get_rmw_implementation_identifier() != _FAST_DDS:
        return None
    try:
        # The handle of the middleware's library finds Fast DDS's functions, too.
        library: Any = ctypes.PyDLL(f"lib{_FAST_DDS}.so")
        instance, load = library[f"{_FACTORY}12get_instanceEv"], library[f"{_FACTORY}24load_XML_profiles_stringEPKcm"]
    except (OSError, AttributeError):
        return None
    instance.argtypes, instance.restype = [], ctypes.c_void_p
    load.argtypes, load.restype = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t], ctypes.c_uint32
    return lambda xml: load(instance(), xml, len(xml))
