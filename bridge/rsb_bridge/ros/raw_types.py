"""Message and service classes for raw use, also of types that are not installed.

`rsb_bridge.ros.native.named_types` makes classes of types that are not installed. Where they do not work
(`rsb_bridge.ros.self_test`), a type's package has to be installed, and rclpy converts the messages of calls.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from rsb_bridge.model.type_names import split_type_name
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.distribution import package_of
from rsb_bridge.ros.native.named_types import BorrowedType, named_services, named_types, nothing
from rsb_bridge.ros.native.typesupport import (
    HASH_PATTERN,
    HASH_PREFIX,
    hash_of,
    installed_class,
    installed_service,
    service_hash_of,
)
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.ros.self_test import findings


def borrow_type(type_name: str, type_hash: str) -> BorrowedType:
    """Return the class for raw endpoints of a type: the installed one, else one made here.

    Args:
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
        "both sides, and restart the bridge that had another"
    )
    HASH_UNKNOWN = "{type_name} is not installed and no {source} tells its type hash: {remedy}"
    INVALID_HASH = "{type_hash!r} is not a type hash: {prefix} and 64 hex digits"
    NOT_CARRIED = "{type_name} is not installed, and {reason}: {remedy}"
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
    return UnusableType.REMEDY(package=package_of(package))


def _check_named(type_name: str, type_hash: str) -> None:
    to_do = remedy(type_name)
    if not type_hash:
        raise RosError(UnusableType.HASH_UNKNOWN(type_name=type_name, source="publisher", remedy=to_do))
    if not re.fullmatch(HASH_PATTERN, type_hash):
        raise RosError(UnusableType.INVALID_HASH(type_hash=type_hash, prefix=HASH_PREFIX))
    if reason := findings().no_messages:
        raise RosError(UnusableType.NOT_CARRIED(type_name=type_name, reason=reason, remedy=to_do))


_HASHES = re.compile(rf"({HASH_PATTERN})\+({HASH_PATTERN})")


class BorrowedService(NamedTuple):
    """A service class that an endpoint uses.

    Attributes:
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
        raise RosError(f"{type_name!r} is not a service type: write it as package/srv/Name")
    if installed is not None:
        here = service_hash_of(installed)
        check_same(type_name, here, type_hash, "service")
        type_hash = here
    reason = findings().no_calls
    if installed is not None and reason:
        return BorrowedService(BorrowedType(installed, nothing), raw=False)
    if not type_hash:
        raise RosError(UnusableType.HASH_UNKNOWN(type_name=type_name, source="node", remedy=remedy(type_name)))
    if not _HASHES.fullmatch(type_hash):
        raise RosError(f"{type_hash!r} is not a service's hash: two of {HASH_PREFIX} and 64 hex digits, with + between")
    if reason:
        raise RosError(UnusableType.NOT_CARRIED(type_name=type_name, reason=reason, remedy=remedy(type_name)))
    # Also of an installed type: to have rclpy convert its messages costs 10 µs to ms a call.
    return BorrowedService(named_services.borrow(type_name, type_hash), raw=True)
