"""Types that are not installed here, known by name and hash alone: how many a link's topics may have at a time."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from rsb_bridge.ros.ros_interface import RosInterface

TYPES_PER_LINK = 256
"""Each takes about 8 kB while an endpoint has it; a robot with all of ROS's common packages has some 200."""


class TypeBudget:
    """One link's.

    Attributes:
        limit: types.
    """

    def __init__(self) -> None:
        self.limit = TYPES_PER_LINK
        self._users: Counter[tuple[str, str]] = Counter()

    @property
    def used(self) -> int:
        """How many types topics have now."""
        return len(self._users)

    def take(self, key: tuple[str, str]) -> None:
        """One more topic has a type.

        Raises:
            RosError: there are too many; the message says what to do.
        """
        if key not in self._users and len(self._users) >= self.limit:
            package = key[0].partition("/")[0]
            raise RosError(
                f"this link's topics have {self.limit} types that are not installed on this side, which is the limit: "
                f"install ros-jazzy-{package.replace('_', '-')} here, or remove topics"
            )
        self._users[key] += 1

    def give(self, key: tuple[str, str]) -> None:
        """A topic has a type no longer."""
        self._users[key] -= 1
        if not self._users[key]:
            del self._users[key]


class TypeUse:
    """The type that one topic's endpoints have."""

    def __init__(self, ros: RosInterface, budget: TypeBudget) -> None:
        """It has none yet.

        Args:
            ros: knows which types are installed.
            budget: of the topic's link.
        """
        self._ros = ros
        self._budget = budget
        self._key: tuple[str, str] | None = None

    def begin(self, type_name: str, type_hash: str, *, is_service: bool = False) -> None:
        """Endpoints of a type are about to be made.

        Args:
            type_name: its name.
            type_hash: which version of it.
            is_service: it is a service's type.

        Raises:
            RosError: the link's topics have too many types.
        """
        self.end()
        installed = self._ros.installed_service_hash if is_service else self._ros.installed_hash
        if installed(type_name) is None:
            self._budget.take((type_name, type_hash))
            self._key = (type_name, type_hash)

    def end(self) -> None:
        """There are no endpoints any more. May be called twice."""
        if self._key is not None:
            self._budget.give(self._key)
            self._key = None
