"""Pictures: images, maps, scans, plots and lists of a topic's messages, drawn by the side that publishes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from rsb_bridge.feature_api import Bridge, Check, Command, ControlMessageBase, EnginePart, Extension, Link, Purpose
    from rsb_console.feature_console import Action, AddCommand, Complete, ConsoleSetting, MessageView, TileLines


class Pictures(Feature):
    name = "pictures"
    libraries: ClassVar[Mapping[str, str]] = {"look": "PIL"}

    def messages(self) -> Iterable[type[ControlMessageBase]]:
        from rsb_extras.pictures.link_views import Look, LookAnswer  # noqa: PLC0415 -- `Feature` says why, here and below

        return Look, LookAnswer

    def purposes(self) -> Iterable[Purpose]:
        from rsb_extras.pictures.link_views import VIEW  # noqa: PLC0415

        return (VIEW,)

    def extensions(self, link: Link) -> Iterable[Extension]:
        from rsb_extras.pictures.link_views import LinkViews  # noqa: PLC0415

        return (LinkViews(link),)

    def commands(self) -> Iterable[type[Command[object]]]:
        from rsb_extras.pictures.look_requests import EndLook, LookAtTopics  # noqa: PLC0415

        return LookAtTopics, EndLook

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.pictures.viewing import Viewing  # noqa: PLC0415

        return (Viewing(bridge),)

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_extras.pictures.look_arguments import add_look  # noqa: PLC0415

        add_look(add, complete)

    def checks(self) -> Iterable[Check]:
        from rsb_bridge.feature_api import Check  # noqa: PLC0415
        from rsb_extras.pictures.confinement_check import confined  # noqa: PLC0415
        from rsb_extras.pictures.terminal_check import terminal  # noqa: PLC0415

        return Check("pictures", "pictures", confined), Check("images", "images", terminal)

    def console_settings(self) -> Iterable[ConsoleSetting[Any]]:
        from rsb_extras.pictures.layouts import LAYOUTS  # noqa: PLC0415

        return (LAYOUTS,)

    def tiles(self) -> Iterable[type[TileLines]]:
        from rsb_extras.pictures.own_tiles import LogLines, RatesLines  # noqa: PLC0415

        return RatesLines, LogLines

    def actions(self) -> Iterable[Action]:
        from rsb_extras.pictures.picture_keys import LOOK  # noqa: PLC0415

        return (LOOK,)

    def message_views(self) -> Iterable[MessageView]:
        from rsb_console.feature_console import MessageView, late  # noqa: PLC0415

        place = "rsb_extras.pictures"
        return (MessageView("picture", late(f"{place}.drawing:has_picture"), late(f"{place}.view_screen:view")),)


FEATURE = Pictures()
