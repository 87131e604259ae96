"""Tests once in a process whether ROS's libraries are as `rsb_bridge.ros.native` assumes, by using them.

The test takes 15 ms, in a context of its own without discovery, so that nothing leaves the process.
"""

from __future__ import annotations

import json
import os
import select
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from functools import cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.context import Context
from rclpy.utilities import get_rmw_implementation_identifier

from rsb_bridge.cdr.known_types import STRING
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.distribution import described, package_of
from rsb_bridge.ros.environment import with_variables
from rsb_bridge.ros.native.cyclone_dds import CYCLONE_DDS
from rsb_bridge.ros.native.fast_cdr import copies_calls
from rsb_bridge.ros.native.librcl import (
    EVENTFD_WRITE,
    ON_ARRIVAL,
    PUBLICATION_NUMBERS,
    TakeBuffer,
    WaitSetHead,
    add_guard_condition,
    feature_supported,
    graph_guard_condition,
    reset_error,
)
from rsb_bridge.ros.native.named_types import named_services, named_types, nothing
from rsb_bridge.ros.native.rclpy_extension import (
    PUBLISHERS,
    SUBSCRIPTIONS,
    ExtensionNode,
    Handle,
    PublicNode,
    UntakenResponses,
    ask,
    reason_of,
    wait_set,
)
from rsb_bridge.ros.native.typesupport import HASH_PREFIX, installed_class, type_support_of
from rsb_bridge.ros.ros_interface import RosError, RosProblem
from rsb_bridge.ros.service_endpoints import CallerTable, RawServiceClient, RawServiceServer
from rsb_bridge.ros.topic_endpoints import Reader, Writer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rsb_bridge.ros.native.named_types import NamedTypes
    from rsb_bridge.ros.native.rclpy_extension import Kind, OwnNode

ARGUMENTS = ["--ros-args", "--disable-rosout-logs", "--disable-stdout-logs", "--disable-external-lib-logs"]
"""ROS arguments of ours alone, not the process's. No log line of rcl's may garble a terminal user interface, and no log
file is written: it would need a home."""
FAST_DDS = "rmw_fastrtps_cpp"

_DOMAIN = 101
"""The last one whose ports Linux gives to no other program (`model.limits.SAFE_DOMAIN`)."""
_ALONE = {
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF",
    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
    "ROS_DISCOVERY_SERVER": None,
    "ROS_SECURITY_ENABLE": None,
}
"""No discovery, no security, and no shared memory, for which processes that test at the same time would compete."""
_QOS = Qos("reliable", "volatile", "keep_last", 5)
_NAME = "/rsb_self_test"
_HASH = HASH_PREFIX + 32 * "5a"
_MESSAGE, _SERVICE = ("rsb_self_test/msg/Any", _HASH), ("rsb_self_test/srv/Any", f"{_HASH}+{_HASH}")
_PAYLOAD = b"\0\1\0\0\4\0\0\0rsb\0"
"""A std_msgs/msg/String, serialized."""
_WITHIN = 1.0
"""s. A round figure: the whole test takes 15 ms, and what does not come within it is not held against ROS."""
_ARRIVALS = "rmw_subscription_set_on_new_message_callback"
"""The only one that is tried: a middleware that has it has those of services and clients, and to load an installed
service takes 0.2 s."""
_RECENT = 60 * 10**9
"""ns. A round figure: in another layout, the field has any number of 64 bits."""


class Shortfall(Wording):
    """The reasons why something does not work with this ROS."""

    ANOTHER_MIDDLEWARE = (
        "messages of types that are not installed need rmw_fastrtps_cpp or rmw_cyclonedds_cpp, and ROS uses "
        "{middleware} here"
    )
    NO_CALLS = "calls of types that are not installed need rmw_fastrtps_cpp, and ROS uses {middleware} here"
    NO_NUMBERS = (
        "{middleware} does not number messages: messages lost in DDS are not counted, and a publisher of a latched "
        "topic counts as keeping 10, unless the route's qos has a depth"
    )
    MESSAGES = "{distribution} does not carry messages of types that are not installed ({error})"
    CALLS = "{distribution} does not carry calls of types that are not installed ({error})"
    NO_ARRIVALS = (
        "{distribution} with {middleware} does not tell which topic a message came to ({error}): each message costs "
        "more, the more topics there are"
    )
    PUBLIC_CLASSES = (
        "the inside of {distribution} differs from what this rsb-console knows ({error}): it uses rclpy's public "
        "classes, and its node publishes /parameter_events"
    )


class Findings(NamedTuple):
    """The test's result.

    Attributes:
        public_only: the reason why rclpy's public classes are used, or an empty string.
        no_messages: the reason why messages of types that are not installed can't be carried, or an empty string.
        no_numbers: the reason why neither losses in DDS nor depths of latched topics are known, or an empty string.
        no_arrivals: the reason why a wait set finds what has come (`rsb_bridge.ros.arrivals`), or an empty string.
    """

    node: type[OwnNode]
    middleware: str
    public_only: str = ""
    no_messages: str = ""
    no_calls: str = ""
    no_numbers: str = ""
    no_arrivals: str = ""

    @property
    def shortfalls(self) -> tuple[str, ...]:
        """The reasons that operators should know."""
        reasons = self.public_only, self.no_messages, self.no_calls, self.no_numbers, self.no_arrivals
        return tuple(dict.fromkeys(filter(None, reasons)))


class _DiffersError(Exception):
    """A message, a call or a struct differs from the expected one; the text names the struct."""


def findings() -> Findings:
    """Return the result of the test, which the first call in this process makes.

    Raises:
        RosError: something is missing without which nothing can be bridged.
    """
    with _testing:  # a test changes the environment
        return _findings()


def test() -> Findings:
    """Run the test; raise what `findings` raises."""
    with _alone() as context:
        try:
            return _found(ExtensionNode, context)
        except (TypeError, AttributeError) as error:
            public_only = Shortfall.PUBLIC_CLASSES(distribution=described(), error=error)
            return _found(PublicNode, context)._replace(public_only=public_only)


_testing = threading.Lock()
_findings = cache(test)


def _found(node: type[OwnNode], context: Context) -> Findings:
    middleware, string = get_rmw_implementation_identifier(), installed_class(STRING)
    if string is None:  # nothing to test with, and nothing to make other types of
        reason = RosProblem.NO_STRINGS(package=package_of("std_msgs"))
        return Findings(node, middleware, "", reason, reason)
    type_support_of(string)  # which loads it
    # First, and an error ends the start: without installed types nothing can be bridged.
    _try(node, context, _messages_cross, string)
    no_numbers = "" if feature_supported(PUBLICATION_NUMBERS) else Shortfall.NO_NUMBERS(middleware=middleware)
    if middleware in {FAST_DDS, CYCLONE_DDS}:
        no_messages = _why_not(Shortfall.MESSAGES, partial(_try, node, context, _messages_cross), named_types, _MESSAGE)
    else:  # it needs symbols that these type supports lack
        no_messages = Shortfall.ANOTHER_MIDDLEWARE(middleware=middleware)
    if middleware == FAST_DDS:
        no_calls = no_messages or _why_not(  # the type of a call consists of two such messages
            Shortfall.CALLS, partial(_try, node, context, _calls_cross), named_services, _SERVICE
        )
    else:
        no_calls = Shortfall.NO_CALLS(middleware=middleware)
    return Findings(node, middleware, "", no_messages, no_calls, no_numbers, _no_arrivals(node, context, string))


@contextmanager
def _alone() -> Iterator[Context]:
    """Make a context that discovers nobody."""
    context = Context()
    try:
        with with_variables(os.environ, _ALONE):
            context.init(ARGUMENTS, domain_id=_DOMAIN)
            yield context
    except (RuntimeError, _DiffersError) as error:
        raise RosError(RosProblem.LACKS(distribution=described(), name=reason_of(error))) from error
    finally:
        context.try_shutdown()
        context.destroy()


def _why_not(
    shortfall: Shortfall, test: Callable[[type], None], types: NamedTypes, name_and_hash: tuple[str, str]
) -> str:
    borrowed = types.borrow(*name_and_hash)
    try:
        test(borrowed.interface)
    except (RosError, RuntimeError, _DiffersError) as error:
        reset_error()
        return shortfall(distribution=described(), error=reason_of(error))
    finally:
        borrowed.give_back()
    return ""


def _no_arrivals(node: type[OwnNode], context: Context, string: type) -> str:
    try:
        _try(node, context, _arrivals_are_told, string)
    except (RosError, _DiffersError) as error:
        return Shortfall.NO_ARRIVALS(
            distribution=described(), middleware=get_rmw_implementation_identifier(), error=reason_of(error)
        )
    return ""


def _try(
    node: type[OwnNode],
    context: Context,
    test: Callable[[_Endpoints, type], None],
    interface: type,
) -> None:
    with ExitStack() as ending:
        own = node(_NAME[1:], context)
        ending.callback(own.destroy)
        test(_Endpoints(own, context, ending), interface)


class _Endpoints:
    """Makes endpoints of a node, and waits for them."""

    def __init__(self, node: OwnNode, context: Context, ending: ExitStack) -> None:
        self.node = node
        self._context = context
        self.ending = ending
        self._entities = threading.RLock()

    def make(self, kind: Kind, interface: type) -> Handle:
        entity = self.node.create(kind, interface, _NAME, _QOS)
        return Handle(entity, nothing, self._entities)

    def closed_at_end(self, endpoint: Any) -> None:
        self.ending.callback(endpoint.close)

    def untaken(self) -> UntakenResponses:
        untaken = UntakenResponses(self._context)
        self.closed_at_end(untaken)
        return untaken

    def wait(self, kind: Kind, handle: Handle, take: Callable[[], Sequence[Any] | None]) -> Any:
        """Return the first thing that comes, or None if nothing comes."""
        room = {f"{kind}s": 1}
        waits = wait_set(self._context, guards=1, **room)
        try:
            deadline = time.monotonic() + _WITHIN
            while time.monotonic() < deadline:
                waits.clear_entities()
                getattr(waits, f"add_{kind}")(handle.rclpy)
                # Nobody waits for it: it shows whether the fields of the struct lie where they are read.
                add_guard_condition(waits.pointer, graph_guard_condition(self.node.handle.pointer), None)
                head = WaitSetHead.from_address(waits.pointer)
                if head.guard_condition_count != 1 or head.subscription_count != (kind == "subscription"):
                    raise _DiffersError("rcl_wait_set_t")
                waits.wait(int(_WITHIN * 1e9))
                if taken := take():
                    return taken[0]
        finally:
            waits.destroy_when_not_in_use()
        return None


def _messages_cross(endpoints: _Endpoints, interface: type) -> None:
    """Publish a message, and compare the taken one. If a middleware takes too long, the test passes."""
    reader = Reader(endpoints.make("subscription", interface), TakeBuffer(), frozenset())
    endpoints.closed_at_end(reader)
    writer = Writer(endpoints.make("publisher", interface), interface)
    endpoints.closed_at_end(writer)
    # The answers do not matter, only whether this distribution takes these arguments.
    for question in (PUBLISHERS, SUBSCRIPTIONS):
        ask(question, endpoints.node.handle, _NAME, False)
    writer.publish(_PAYLOAD)
    taken = endpoints.wait("subscription", reader.handle, lambda: reader.take(1, ()))
    if taken is None:
        return
    if taken.payload != _PAYLOAD:
        raise _DiffersError("rcl_serialized_message_t")
    known = taken.gid == writer.gid and taken.number in {0, 1}
    if not known or (taken.source and abs(taken.source - time.time_ns()) > _RECENT):
        raise _DiffersError("rmw_message_info_t")


def _arrivals_are_told(endpoints: _Endpoints, interface: type) -> None:
    """Publish a message, and wait for its event. If a middleware takes too long, the test passes."""
    if sys.maxsize < 2**32:  # `EVENTFD_WRITE`
        raise _DiffersError("eventfd_write")
    descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
    endpoints.ending.callback(os.close, descriptor)
    reader = Reader(endpoints.make("subscription", interface), TakeBuffer(), frozenset())
    endpoints.closed_at_end(reader)
    if ON_ARRIVAL["subscription"](reader.handle.address, EVENTFD_WRITE, descriptor):
        reset_error()
        raise _DiffersError(_ARRIVALS)
    endpoints.ending.callback(ON_ARRIVAL["subscription"], reader.handle.address, None, None)
    writer = Writer(endpoints.make("publisher", interface), interface)
    endpoints.closed_at_end(writer)
    writer.publish(_PAYLOAD)
    told, _, _ = select.select([descriptor], [], [], _WITHIN)
    if not told and reader.take(1, ()):
        raise _DiffersError(_ARRIVALS)


def _calls_cross(endpoints: _Endpoints, interface: type) -> None:
    """Call a service and answer, and compare both."""
    if not copies_calls():
        raise _DiffersError("Fast CDR")
    served, called = endpoints.make("service", interface), endpoints.make("client", interface)

    def ask_dds(question: Callable[..., Any], topic: str) -> Any:
        return ask(question, endpoints.node.handle, topic, True)

    server = RawServiceServer(served, _NAME, CallerTable(ask_dds, _NAME, _QOS, lambda: 0), lambda _: None)
    endpoints.closed_at_end(server)
    client = RawServiceClient(called, _NAME, endpoints.untaken())
    endpoints.closed_at_end(client)
    number = client.call(_PAYLOAD)
    request = endpoints.wait("service", served, lambda: server.take(1))
    if request is None:
        return
    if request.payload != _PAYLOAD:
        raise _DiffersError("rmw_request_id_t")
    server.answer(request.caller, _PAYLOAD)
    response = endpoints.wait("client", called, lambda: client.take(1))
    if response is not None and (response.payload, response.number) != (_PAYLOAD, number):
        raise _DiffersError("rmw_service_info_t")


def main() -> None:
    """Print the findings as JSON, for `rsb_extras.doctor`, which survives a crash of this process."""
    began = time.monotonic()
    try:
        found = findings()
    except RosError as error:
        result: dict[str, Any] = {"error": str(error)}
    else:
        result = {"middleware": found.middleware, "shortfalls": found.shortfalls}
    sys.stdout.write(json.dumps(result | {"seconds": time.monotonic() - began}) + "\n")


if __name__ == "__main__":
    main()
