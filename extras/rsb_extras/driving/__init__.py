"""Driving: messages that operators publish by hand, and a robot that they drive by the keys of a console."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.feature_api import Bridge, Command, EnginePart
    from rsb_console.feature_console import Action, AddCommand, Complete, ConsoleSetting


class Driving(Feature):
    name = "driving"

    def commands(self) -> Iterable[type[Command[Any]]]:
        from rsb_extras.driving.publish_requests import DraftMessage, Publish  # noqa: PLC0415 -- `Feature` says why

        return DraftMessage, Publish

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.driving.publishing import Publishing  # noqa: PLC0415

        return (Publishing(bridge),)

    def console_settings(self) -> Iterable[ConsoleSetting[float]]:
        from rsb_extras.driving.picture_lock import PICTURE_AGE  # noqa: PLC0415

        return (PICTURE_AGE,)

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_extras.driving.pub_arguments import add_pub  # noqa: PLC0415

        add_pub(add, complete)

    def actions(self) -> Iterable[Action]:
        from rsb_extras.driving.driving_keys import DRIVE, PUBLISH  # noqa: PLC0415

        return PUBLISH, DRIVE


FEATURE = Driving()
