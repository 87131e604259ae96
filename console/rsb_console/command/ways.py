"""Ways to bridges of other machines, which features bring: each is an option that names a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from rsb_bridge.installed_features import added

if TYPE_CHECKING:
    from rsb_bridge.control.remote_engine import RemoteEngine


class RemoteWay:
    """A way to bridges, by a file that an option names. Its module is imported with the options of each command.

    Attributes:
        option: the option, for example ``--fleet``.
        one: help for the option of commands for one bridge.
        many: help for the option of commands for all of its bridges.
        file: the file's path.
    """

    option: ClassVar[str]
    one: ClassVar[str]
    many: ClassVar[str]

    def __init__(self, file: str) -> None:
        self.file = Path(file)

    def check(self) -> None:
        """Raise `rsb_console.command.target.UsageError` if the file has mistakes."""

    def attach(self, bridge: str, *, read_only: bool) -> RemoteEngine:
        """Attach to a bridge.

        Args:
            bridge: its name, or an empty string for the only one.

        Raises:
            EngineError: the attachment fails.
            UsageError: the file has mistakes.
        """
        raise NotImplementedError

    def robots(self) -> Any:
        """Return all of its bridges, for a fleet: a `FleetSource` of the feature `fleet`.

        Raises:
            UsageError: the file has mistakes.
        """
        raise NotImplementedError


def ways() -> list[type[RemoteWay]]:
    """Return the ways that are installed."""
    return list(added("ways", name_of=lambda way: way.option))
