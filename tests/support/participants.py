"""Makes the ROS participants of this process known to each other before a test goes on.

Two participants of one process miss each other's first announcements in a third of all cases, and hear the next one
only 3 s later. So this process announces its participants more often; children of a test do not. Fast DDS may
even leave them undiscovered for good; then no message of one reaches the other. No robot has two participants of a
domain in one process. So a new participant waits until all know each other. If they do not, it leaves and joins again,
which no test notices.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from tests.support.inside import participant_of
from tests.support.waiting import pauses

from rsb_bridge.ros.memory import profile_variable
from rsb_bridge.ros.node import RosNode

_KNOWN_WITHIN = 15.0
"""s; DDS announces a participant five times at once, and then as often as the profile says."""
_PROFILE = Path(__file__).with_suffix(".xml")
_ATTEMPTS = 4
_present: WeakKeyDictionary[Any, int] = WeakKeyDictionary()
"""Nodes, by which participants are known, and their domains."""


def join(domain_id: int, enter: Callable[[], Any], leave: Callable[[], None]) -> None:
    """Join a domain, and be known there.

    Args:
        enter: joins it; the node of that participant, as rclpy has it.

    Raises:
        AssertionError: it is not known, however often it joins.
    """
    for _ in range(_ATTEMPTS):
        with _announced_often():
            node = enter()
        for each in [each for each in _present if _gone(each)]:
            del _present[each]
        others = [each for each, domain in _present.items() if domain == domain_id]
        if _know_each_other(node, others):
            _present[node] = domain_id
            return
        seen = {_name(each): _seen_by(each) for each in (node, *others)}
        leave()
    raise AssertionError(f"not all know each other: {seen}")


@contextmanager
def _announced_often() -> Iterator[None]:
    """Have Fast DDS read this process's profile, which it does with the first participant; children inherit nothing."""
    name = profile_variable(os.environ)
    if name in os.environ:
        yield
        return
    os.environ[name] = str(_PROFILE)
    try:
        yield
    finally:
        del os.environ[name]


def differences() -> str:
    """Return the differences between the graphs of a domain's participants: missing nodes, and counts of endpoints."""
    try:
        return "\n".join(_differences()) or "nothing"
    except RuntimeError as error:
        return f"one has left meanwhile: {error}"


def _differences() -> list[str]:
    lines = []
    for domain in sorted({*_present.values()}):
        nodes = {_name(each): each for each, where in _present.items() if where == domain and not _gone(each)}
        for name, node in nodes.items():
            lines += [f"{domain} {name} does not know {each}" for each in sorted(nodes.keys() - _seen_by(node))]
        counted = {name: _endpoints_of(node) for name, node in nodes.items()}
        for topic in sorted({topic for each in counted.values() for topic in each}):
            said = {name: each.get(topic, (0, 0)) for name, each in counted.items()}
            if len({*said.values()}) > 1:
                lines.append(f"{domain} {topic}: publishers and subscriptions {said}")
    return lines


def _endpoints_of(node: Any) -> dict[str, tuple[int, int]]:
    handle = getattr(node, "handle", node)
    with handle:
        topics = [name for name, _ in _rclpy.rclpy_get_topic_names_and_types(handle, False)]
        return {each: (handle.get_count_publishers(each), handle.get_count_subscribers(each)) for each in topics}


def agree(domain_id: int, topic: str) -> bool:
    """Whether the participants of a domain know of the same endpoints of a topic, as far as their nodes have them.

    A participant that was just destroyed still counts for the others, and a new one does not count yet.
    """
    nodes = [each for each, where in _present.items() if where == domain_id and not _gone(each)]
    try:
        names = {_name(each) for each in nodes}
        return len({_known_of(each, topic, names) for each in nodes}) <= 1
    except RuntimeError:  # one has left meanwhile
        return False


def _known_of(node: Any, topic: str, names: set[str]) -> frozenset[bytes]:
    handle = getattr(node, "handle", node)
    asks = _rclpy.rclpy_get_publishers_info_by_topic, _rclpy.rclpy_get_subscriptions_info_by_topic
    with handle:
        found = [each for ask in asks for each in ask(handle, topic, False)]
    return frozenset(
        bytes(each["endpoint_gid"])
        for each in found
        if f"{each['node_namespace'].rstrip('/')}/{each['node_name']}" in names
    )


class KnownNode(RosNode):
    """A bridge's node that the others of this process know before the bridge uses it."""

    def __init__(self, domain_id: int, name: str) -> None:
        super().__init__(domain_id, name)
        self._entered = domain_id, name

    def start(self) -> None:
        def enter() -> Any:
            super(KnownNode, self).start()
            return participant_of(self)._node.handle

        def leave() -> None:
            self.stop()
            RosNode.__init__(self, *self._entered)  # a node is started once

        join(self._entered[0], enter, leave)


def _know_each_other(node: Any, others: list[Any]) -> bool:
    deadline, pause = time.monotonic() + _KNOWN_WITHIN, pauses()
    while time.monotonic() < deadline:
        seen = _seen_by(node)
        if all(_gone(each) or (_name(each) in seen and _name(node) in _seen_by(each)) for each in others):
            return True
        time.sleep(next(pause))
    return False


def _name(node: Any) -> str:
    return str(node.get_fully_qualified_name())


def _seen_by(node: Any) -> set[str]:
    """The nodes that one knows; it knows them only once both have the other's endpoints."""
    try:
        handle = getattr(node, "handle", node)
        with handle:
            found = handle.get_node_names_and_namespaces()
    except RuntimeError:  # it has left
        return set()
    return {f"{namespace.rstrip('/')}/{name}" for name, namespace, *_ in found}


def _gone(node: Any) -> bool:
    return not _seen_by(node)
