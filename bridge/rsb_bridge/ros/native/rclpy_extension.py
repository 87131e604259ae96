"""Nodes, their endpoints, wait sets and questions to the graph, by rclpy's extension module.

rclpy's executors cost three times as much, and its `Node` has a publisher and services that the bridge would not serve.
But the signatures of the extension module differ between distributions. So `ExtensionNode` tries the known ones, and
`PublicNode` does the same with rclpy's documented classes.
"""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import QoSProfile

from rsb_bridge.ros.distribution import described
from rsb_bridge.ros.native.librcl import reset_error
from rsb_bridge.ros.native.rcl_conversions import rcl_profile
from rsb_bridge.ros.ros_interface import RosError, RosProblem

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable

    from rclpy.context import Context

    from rsb_bridge.model.qos import Qos

Kind: TypeAlias = Literal["subscription", "publisher", "service", "client"]
Question: TypeAlias = "Callable[..., Any]"
"""Asks the graph: takes a node's handle, and names."""


def reason_of(error: Exception) -> str:
    """Return an rcl error without the places in its source code."""
    return str(error).partition(", at ")[0]


def named(name: str) -> Any:
    """Return a member of the extension module, or a function that raises if it is missing."""

    def missing(*_arguments: object) -> None:
        raise RosError(RosProblem.LACKS(distribution=described(), name=f"rclpy's {name}"))

    # It raises only when it is used: an error of this import would tell operators nothing.
    return getattr(_rclpy, name, missing)


TOPICS: Final[Question] = named("rclpy_get_topic_names_and_types")
SERVICES: Final[Question] = named("rclpy_get_service_names_and_types")
PUBLISHERS: Final[Question] = named("rclpy_get_publishers_info_by_topic")
SUBSCRIPTIONS: Final[Question] = named("rclpy_get_subscriptions_info_by_topic")
_TOPICS_OF_NODE: Final = tuple(named(f"rclpy_get_{end}_names_and_types_by_node") for end in ("publisher", "subscriber"))
_CALLS_OF_NODE: Final = tuple(named(f"rclpy_get_{end}_names_and_types_by_node") for end in ("service", "client"))

_CLASSES = {kind: named(kind.capitalize()) for kind in ("subscription", "publisher", "service", "client")}
_node, _wait_set, _guard_condition = named("Node"), named("WaitSet"), named("GuardCondition")
_event = named("EventHandle")
deserialize: Final = named("rclpy_deserialize")
"""Returns a message, given its bytes and its class."""
assert_liveliness: Final = named("rclpy_assert_liveliness")
"""Asserts that a publisher is alive: takes the extension module's object."""


def ask(question: Question, *arguments: object) -> Any:
    """Ask the graph.

    Raises:
        RosError: rcl can't answer, or the question takes other arguments in this distribution.
    """
    try:
        return question(*arguments)
    except RuntimeError as error:
        raise RosError(RosProblem.GRAPH_UNREADABLE(reason=reason_of(error))) from error
    except TypeError as error:
        raise RosError(RosProblem.LACKS(distribution=described(), name=_name_of(question))) from error


def _name_of(question: Question) -> str:
    return _name_of(question.args[0]) if isinstance(question, partial) else question.__name__


def nodes_of(node: Any) -> list[tuple[str, str]]:
    """Return the full name of each node of the graph, and the enclave of its context.

    Args:
        node: the extension module's object that asks.

    Raises:
        RosError: rcl can't answer.
    """
    found = ask(node.get_node_names_and_namespaces_with_enclaves)
    return [(f"{namespace.rstrip('/')}/{name}", enclave) for name, namespace, enclave in found]


def names_of_node(node: Any, name: str, namespace: str) -> list[list[tuple[str, list[str]]]]:
    """Return the names, with types, that a node publishes, hears, serves and calls, or none of a node that has gone.

    Args:
        node: the extension module's object that asks.

    Raises:
        RosError: rcl can't answer.
    """

    def asked(question: Question, *arguments: object) -> Any:
        try:
            return question(node, *arguments, name, namespace)
        except _rclpy.NodeNameNonExistentError:
            return []

    return [
        *(ask(partial(asked, each), False) for each in _TOPICS_OF_NODE),
        *(ask(partial(asked, each)) for each in _CALLS_OF_NODE),
    ]


def wait_set(context: Context, *, subscriptions: int = 0, guards: int = 0, clients: int = 0, services: int = 0) -> Any:
    """Return a wait set with room for so many entities."""
    return _wait_set(subscriptions, guards, 0, clients, services, 0, context.handle)


def guard_condition(context: Context) -> Any:
    """Return a guard condition."""
    return _guard_condition(context.handle)


class UntakenResponses:
    """Asks whether DDS holds responses that were not taken, by a wait set. For one thread."""

    def __init__(self, context: Context) -> None:
        self._waits = wait_set(context, guards=1, clients=1)
        self._no_wait = guard_condition(context)

    def has(self, client: Any) -> bool:
        """Return whether DDS holds some for a client, the extension module's object.

        Raises:
            RuntimeError: rcl refused it.
        """
        # Where nothing is ready, rmw_fastrtps takes 80 µs to wait for 0 s, and else 1 µs.
        self._no_wait.trigger_guard_condition()
        return self.wait(client, 0)

    def wait(self, client: Any, longest_ns: int) -> bool:
        """Wait until DDS holds some for a client, and return whether it does.

        Raises:
            RuntimeError: rcl refused it.
        """
        self._waits.clear_entities()
        self._waits.add_guard_condition(self._no_wait)
        self._waits.add_client(client)
        self._waits.wait(longest_ns)
        return bool(self._waits.get_ready_entities("client"))

    def close(self) -> None:
        """To be called once."""
        for handle in (self._waits, self._no_wait):
            handle.destroy_when_not_in_use()


class _ExtensionEntity:
    def __init__(self, rclpy: Any) -> None:
        self.rclpy = rclpy
        self.destroy = rclpy.destroy_when_not_in_use


class ExtensionNode:
    """A node by the extension module alone.

    Raises:
        TypeError: the module has other signatures than the known ones.
        RuntimeError: rcl refused it.
    """

    def __init__(self, name: str, context: Context, namespace: str = "/") -> None:
        # No ROS arguments, the process's do not count, and nothing is logged to /rosout.
        arguments: tuple[Any, ...] = (name, namespace, context.handle, [], False, False)
        try:
            self.handle = _node(*arguments)
        except TypeError:  # from Kilted on, with the QoS of rosout
            self.handle = _node(*arguments, QoSProfile(depth=1).get_c_qos_profile())
        self.destroy = self.handle.destroy_when_not_in_use

    def create(self, kind: Kind, interface: type, name: str, qos: Qos) -> Entity:
        """Create an endpoint.

        Raises:
            ValueError: the name is invalid.
            RuntimeError: rcl refused it.
        """
        return _ExtensionEntity(_CLASSES[kind](self.handle, interface, name, rcl_profile(qos).get_c_qos_profile()))


class _PublicEntity:
    def __init__(self, entity: Any, destroy: Callable[[Any], object]) -> None:
        self.rclpy = entity.handle
        self._entity = entity
        self._destroy = destroy

    def destroy(self) -> None:
        self._destroy(self._entity)


class PublicNode:
    """A node by rclpy's documented class, which publishes parameter events besides.

    Raises:
        RuntimeError: rcl refused it.
    """

    def __init__(self, name: str, context: Context, namespace: str = "/") -> None:
        from rclpy.node import Node  # noqa: PLC0415  3 MB, which nobody needs where `ExtensionNode` works
        from rclpy.parameter import Parameter  # noqa: PLC0415

        self._node = node = Node(
            name,
            namespace=namespace,
            context=context,
            cli_args=[],
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self.handle = node.handle
        self._parameter_events = tuple(node.publishers)
        self._ways: dict[Kind, tuple[Callable[..., Any], Callable[[Any], object]]] = {
            "subscription": (
                lambda interface, topic, qos: node.create_subscription(interface, topic, _nothing, qos, raw=True),
                node.destroy_subscription,
            ),
            "publisher": (node.create_publisher, node.destroy_publisher),
            "service": (
                lambda interface, name, qos: node.create_service(interface, name, _nothing, qos_profile=qos),
                node.destroy_service,
            ),
            "client": (
                lambda interface, name, qos: node.create_client(interface, name, qos_profile=qos),
                node.destroy_client,
            ),
        }

    def destroy(self) -> None:
        """End it once its endpoints have been destroyed: `Node.destroy_node` would free these, which are in use."""
        for each in self._parameter_events:
            self._node.destroy_publisher(each)
        self.handle.destroy_when_not_in_use()

    def create(self, kind: Kind, interface: type, name: str, qos: Qos) -> Entity:
        create, destroy = self._ways[kind]
        try:
            return _PublicEntity(create(interface, name, rcl_profile(qos)), destroy)
        except (AssertionError, TypeError, AttributeError) as error:  # it wants the layout of a type
            raise RuntimeError(str(error)) from error


Entity: TypeAlias = _ExtensionEntity | _PublicEntity
"""An endpoint that a node has made. Its `rclpy` is the extension module's object."""
OwnNode: TypeAlias = ExtensionNode | PublicNode
"""A node without parameters, services and log topic. Its `handle` is the extension module's object."""


def _nothing(*_arguments: object) -> None:
    """Nobody spins the node."""


class Handle:
    """An endpoint, and the type that it uses.

    Attributes:
        rclpy: the extension module's object.
        address: of what rcl has of it.
    """

    def __init__(self, entity: Entity, give_back: Callable[[], None], entities: threading.RLock) -> None:
        """Hold one that was just created.

        Args:
            give_back: called when nothing uses its type any more.
            entities: held while its participant's endpoints are created or freed.
        """
        reset_error()  # from Kilted on, one is set after a type without fields, and rcl would write to the terminal
        self.rclpy = entity.rclpy
        self.address: int = entity.rclpy.pointer
        self._entity = entity
        self._give_back = give_back
        self._entities = entities

    def free(self) -> None:
        """To be called once."""
        with self._entities:
            self._entity.destroy()
        self._give_back()


_REFUSALS = {
    "subscription": ("rcl_subscription_event_type_t", "RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS"),
    "publisher": ("rcl_publisher_event_type_t", "RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS"),
}


def refuses(kind: Literal["subscription", "publisher"], endpoint: Any) -> bool:
    """Whether the last end that DDS refused for a policy has another one than ROS knows. Takes up to 100 µs.

    Args:
        endpoint: the extension module's object.
    """
    enumeration, member = _REFUSALS[kind]
    try:
        event = _event(endpoint, getattr(getattr(_rclpy, enumeration), member))
        with event:
            told = event.take_event()
        event.destroy_when_not_in_use()
    except (RuntimeError, AttributeError, RosError):  # closed, or a middleware or a distribution that does not tell
        return False
    return bool(told.total_count) and told.last_policy_kind.name == "RMW_QOS_POLICY_INVALID"


class LivelinessOfPublishers:
    """The liveliness of the publishers that match a subscription, which asks DDS for it."""

    def __init__(self, subscription: Any) -> None:
        """Ask for it from now on.

        Args:
            subscription: the extension module's object.
        """
        self._event: Any = None
        with suppress(RuntimeError, RosError):  # a middleware, or a distribution, that does not tell
            self._event = _event(subscription, _rclpy.rcl_subscription_event_type_t.RCL_SUBSCRIPTION_LIVELINESS_CHANGED)

    def ask(self) -> tuple[int, int] | None:
        """Return how many are alive and how many are not, our own node's too, or None if closed, or if nobody tells.

        To ask takes up to 60 µs.
        """
        if self._event is None:
            return None
        try:
            with self._event:
                told = self._event.take_event()
        except RuntimeError:
            return None
        return told.alive_count, told.not_alive_count

    def close(self) -> None:
        """To be called before its subscription is freed."""
        if self._event is not None:
            self._event.destroy_when_not_in_use()
