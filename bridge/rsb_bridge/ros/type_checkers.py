"""The checkers of message types, made of descriptions that come from this side alone.

A peer's description is not used: it would be checked by its own word. So a type is described by its installed package,
or by a node of this domain that uses it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.cdr.checker import Checker, UncheckableError
from rsb_bridge.cdr.description import DescriptionError, read_description

if TYPE_CHECKING:
    from rsb_bridge.ros.api import RosInterface
    from rsb_bridge.ros.type_descriptions import TypeDescriptions

KEPT = 512
"""Types whose checkers are kept: a robot with all of ROS's common packages has some 200."""


class TypeCheckers:
    """Checkers by their types' hashes.

    Args:
        ros: knows which types are installed.
        descriptions: asks the nodes of this domain.
    """

    def __init__(self, ros: RosInterface, descriptions: TypeDescriptions) -> None:
        self._ros = ros
        self._descriptions = descriptions
        self._kept: dict[str, Checker | None] = {}  # the one that was used last stands last

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
