"""Units: what operators may start, stop and restart on a machine, by commands that its own session file lists."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.feature_api import Feature, PeerRight, SessionKey

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from rsb_bridge.feature_api import Bridge, Command, ControlMessageBase, EnginePart, Extension, Link
    from rsb_console.feature_console import Action, AddCommand, Complete


class ListedUnit(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Something that supervises nodes. Each action is a program and its arguments; no shell reads them.

    Attributes:
        status: tells by its exit code whether it runs (`unit_process.state_of`).
        log: prints the end of its log.
        nodes: full names of the ROS nodes that it runs.
        timeout: s for an action, until the unit is in its new state.
    """

    start: tuple[str, ...] = ()
    stop: tuple[str, ...] = ()
    restart: tuple[str, ...] = ()
    status: tuple[str, ...] = ()
    log: tuple[str, ...] = ()
    nodes: tuple[str, ...] = ()
    timeout: float = 30.0


UNITS: SessionKey[dict[str, ListedUnit]] = SessionKey(
    "units", dict[str, ListedUnit], {}, live=True, hidden_as="list of commands"
)
"""The units of this machine, by name."""
MAY_ASK: PeerRight[tuple[str, ...]] = PeerRight("units", tuple[str, ...], ())
"""The units whose actions the other side may ask for."""


class Units(Feature):
    name = "units"

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        return (UNITS,)

    def rights(self) -> Iterable[PeerRight[Any]]:
        return (MAY_ASK,)

    def problems(self, session: Any) -> Iterable[tuple[str, str]]:
        from rsb_extras.units import unit_rules  # noqa: PLC0415 -- `Feature` says why, here and below

        return unit_rules.problems(session)

    def advice(self, session: Any, file: Path | None) -> Iterable[tuple[str, str]]:
        from rsb_extras.units import unit_rules  # noqa: PLC0415

        return unit_rules.advice(session, file)

    def effects(self, session: Any) -> Iterable[str]:
        from rsb_extras.units import unit_rules  # noqa: PLC0415

        return unit_rules.effects(session)

    def messages(self) -> Iterable[type[ControlMessageBase]]:
        from rsb_extras.units.link_units import AskUnits, RunUnit, UnitAnswer, UnitEnded  # noqa: PLC0415

        return AskUnits, UnitAnswer, RunUnit, UnitEnded

    def extensions(self, link: Link) -> Iterable[Extension]:
        from rsb_extras.units.link_units import LinkUnits  # noqa: PLC0415

        return (LinkUnits(link),)

    def commands(self) -> Iterable[type[Command[Any]]]:
        from rsb_extras.units.unit_requests import ControlUnit, ListUnits  # noqa: PLC0415

        return ListUnits, ControlUnit

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.units.units_part import UnitsPart  # noqa: PLC0415

        return (UnitsPart(bridge),)

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_extras.units.units_arguments import add_units  # noqa: PLC0415

        add_units(add, complete)

    def actions(self) -> Iterable[Action]:
        from rsb_console.feature_console import Action, Group, late  # noqa: PLC0415
        from rsb_extras.units.units_arguments import CHAPTER  # noqa: PLC0415

        return (
            Action(
                "units", "U", "units", "Show the units of both sides; start, stop or restart one", Group.OPERATE,
                also="systemd, systemctl, docker, restart a node", run=late("rsb_extras.units.units_screen:show_units"),
                chapters=(CHAPTER,),
            ),
        )  # fmt: skip


FEATURE = Units()
