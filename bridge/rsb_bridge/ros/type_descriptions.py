"""The descriptions of message types that this side has, from any source, and their checkers."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.cdr.checker import Checker, UncheckableError
from rsb_bridge.cdr.description import DescriptionError, hash_of_text, read_description
from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.ros.ros_interface import RosInterface

_KEPT = 4 << 20
"""Characters of all descriptions together; a whole robot's take some 100,000."""
_NODES = 3
"""Nodes that are asked for one description. Each may take 2.5 s (`description_service.ask_node`)."""
_FIRST_PAUSE, _LONGEST_PAUSE = 10.0, 120.0
"""s until nodes are asked again: one that starts later may have the answer. It doubles, as other types wait meanwhile:
seven types that nobody describes take 10 s each time if each has three nodes that lack the service."""
_REMEMBERED = 1000
"""Types that nobody could describe. A round figure: a peer names them."""


class TypeDescriptions:
    """Descriptions by their types' hashes. A text that does not describe its type is dropped.

    Args:
        now: the clock that all timers use, in s.
    """

    def __init__(self, ros: RosInterface, now: Callable[[], float]) -> None:
        self._ros = ros
        self._now = now
        self._texts: dict[str, str] = {}  # in the order of use, the newest last
        self._unknown: dict[str, tuple[float, float]] = {}  # when to ask again, and the pause before
        self._asking = asyncio.Lock()
        self._closed = False

    def close(self) -> None:
        """Ask nobody any more."""
        self._closed = True

    def add(self, text: str, type_hash: str) -> bool:
        """Keep a description; whether it is that type's."""
        try:
            read_description(text, type_hash)
        except DescriptionError:
            return False
        self._texts[type_hash] = text
        while sum(map(len, self._texts.values())) > _KEPT:
            del self._texts[next(iter(self._texts))]
        return True

    def known(self, type_hash: str) -> str | None:
        """Return the text of a description that is kept already, else None."""
        text = self._texts.pop(type_hash, None)
        if text is not None:
            self._texts[type_hash] = text
        return text

    def installed(self, type_name: str) -> str | None:
        """Return the text of an installed type's description, or None if it is not installed."""
        return self._ros.installed_description(type_name)

    async def find(self, type_name: str, type_hash: str, topic: str) -> str | None:
        """The text of a type's description: as installed here, or as announced by a node that uses the type on a topic.

        None: nobody on this side knows it. That may take some seconds to find out, and is then taken for true for a
        while. Nodes are asked for one type at a time.
        """
        if self._is_settled(type_hash):
            return self.known(type_hash)
        text = await asyncio.to_thread(self._installed, type_name, type_hash)
        if text is not None and self.add(text, type_hash):
            return text
        async with self._asking:
            if self._is_settled(type_hash):  # somebody else has asked for it while this one waited
                return self.known(type_hash)
            text = await asyncio.to_thread(self._ask_nodes, type_name, type_hash, topic)
            if text is not None and self.add(text, type_hash):
                return text
            _, pause = self._unknown.pop(type_hash, (0.0, _FIRST_PAUSE / 2))
            if len(self._unknown) >= _REMEMBERED:
                self._unknown.clear()
            pause = min(2 * pause, _LONGEST_PAUSE)
            self._unknown[type_hash] = self._now() + pause, pause
            return None

    def _is_settled(self, type_hash: str) -> bool:
        """Whether the question for a type's description is settled: it is here, or nobody has it."""
        return self.known(type_hash) is not None or self._now() < self._unknown.get(type_hash, (0.0, 0.0))[0]

    def _installed(self, type_name: str, type_hash: str) -> str | None:
        """Find a description among the installed types. Called on a thread, as a type may have to be loaded."""
        ros = self._ros
        return ros.installed_description(type_name) if ros.installed_hash(type_name) == type_hash else None

    def _ask_nodes(self, type_name: str, type_hash: str, topic: str) -> str | None:
        """Ask the nodes that use a type. Called on a thread that may wait."""
        ros = self._ros
        try:
            endpoints = [*ros.publishers(topic), *ros.subscriptions(topic)]
            having = [each.node for each in endpoints if each.type_hash == type_hash]
            nodes = dict.fromkeys(each for each in having if each.startswith("/"))
            for node in list(nodes)[:_NODES]:
                text = ros.ask_description(node, type_name, type_hash, lambda: not self._closed)
                # Any node may answer anything; the next one may have the right one.
                if text is not None and hash_of_text(text) == type_hash:
                    return text
        except RosError:
            pass  # the caller gets no description
        return None


KEPT = 512
"""Types whose checkers are kept: a robot with all of ROS's common packages has some 200."""


class TypeCheckers:
    """Checkers of messages by their types' hashes, made of descriptions that come from this side alone.

    A peer's description is not used: it would be checked by its own word. So a type is described by its installed
    package, or by a node of this domain that uses it.
    """

    def __init__(self, ros: RosInterface, descriptions: TypeDescriptions) -> None:
        self._ros = ros
        self._descriptions = descriptions
        self._kept: dict[str, Checker | None] = {}  # in the order of use, the newest last

    def installed(self, type_name: str) -> Checker | None:
        """Return the checker of a type that is installed here, or None if it is not, or cannot be checked.

        Args:
            type_name: ``pkg/msg/Name``, or ``pkg/srv/Name_Request`` and the like.
        """
        type_hash = self._ros.installed_hash(type_name)
        if not type_hash:
            return None
        if type_hash in self._kept:
            return self._use(type_hash)
        text = self._ros.installed_description(type_name)
        return None if text is None else self._add(text, type_hash)

    async def find(self, type_name: str, type_hash: str, topic: str) -> Checker | None:
        """Return the checker of a type that a node of this domain uses on a topic, or None if no node describes it."""
        if type_hash in self._kept:
            return self._use(type_hash)
        text = await self._descriptions.find(type_name, type_hash, topic)
        return None if text is None else self._add(text, type_hash)

    def _use(self, type_hash: str) -> Checker | None:
        checker = self._kept[type_hash] = self._kept.pop(type_hash)
        return checker

    def _add(self, text: str, type_hash: str) -> Checker | None:
        try:
            checker = Checker(read_description(text, type_hash))
        except (DescriptionError, UncheckableError):
            checker = None
        self._kept[type_hash] = checker
        while len(self._kept) > KEPT:
            del self._kept[next(iter(self._kept))]
        return checker
