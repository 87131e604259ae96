"""The descriptions of message types that this side knows, whoever told them."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.cdr.description import DescriptionError, hash_of_text, read_description
from rsb_bridge.ros.api import RosError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.ros.api import RosInterface

_KEPT = 4 << 20
"""Characters of all descriptions together; those of a whole robot take some 100,000."""
_NODES = 3
"""Nodes that are asked for one description."""
_ASKS_AGAIN_AFTER = 10.0  # s
_REMEMBERED = 1000
"""Types that nobody could describe."""


class TypeDescriptions:
    """Descriptions by their types' hashes. What is not the description of its type is not kept.

    Args:
        ros: this side's types and nodes.
        now: the clock that all timers use, in s.
    """

    def __init__(self, ros: RosInterface, now: Callable[[], float]) -> None:
        self._ros = ros
        self._now = now
        self._texts: dict[str, str] = {}  # the one that was used last stands last
        self._unknown: dict[str, float] = {}
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
        """The text of a description that is kept already, else None."""
        text = self._texts.pop(type_hash, None)
        if text is not None:
            self._texts[type_hash] = text
        return text

    async def find(self, type_name: str, type_hash: str, topic: str) -> str | None:
        """The text of a type's description: as installed here, or as told by a node that uses the type on a topic.

        None: nobody on this side knows it. That may take some seconds to find out, and is then taken for true for a
        while. One type is looked for at a time.
        """
        if (text := self.known(type_hash)) is not None:
            return text
        async with self._asking:
            text = self.known(type_hash)
            if text is not None or self._now() < self._unknown.get(type_hash, 0.0):
                return text
            text = await asyncio.to_thread(self._find, type_name, type_hash, topic)
            if text is not None and self.add(text, type_hash):
                return text
            if len(self._unknown) >= _REMEMBERED:
                self._unknown.clear()
            self._unknown[type_hash] = self._now() + _ASKS_AGAIN_AFTER
            return None

    def _find(self, type_name: str, type_hash: str, topic: str) -> str | None:
        """Look for it; on a thread that may wait."""
        ros = self._ros
        if ros.installed_hash(type_name) == type_hash:
            return ros.installed_description(type_name)
        try:
            endpoints = [*ros.publishers(topic), *ros.subscriptions(topic)]
            nodes = dict.fromkeys(each.node for each in endpoints if each.node and each.type_hash == type_hash)
            for node in list(nodes)[:_NODES]:
                text = ros.ask_description(node, type_name, type_hash, lambda: not self._closed)
                if text is not None and hash_of_text(text) == type_hash:
                    return text
        except RosError:
            pass  # whoever asks is told that nobody knows it
        return None
