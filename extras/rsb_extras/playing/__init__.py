"""Playing: the messages of a recording, published in a domain with their times, or looked at in a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from rsb_console.feature_console import AddCommand, Complete, LookOption


class PlayingFeature(Feature):
    name = "playing"
    needs = ("pictures", "recording")
    libraries: ClassVar[Mapping[str, str]] = {"record": "mcap"}

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_extras.playing.play_arguments import add_play, add_review  # noqa: PLC0415 -- `Feature` says why

        add_play(add, complete)
        add_review(add, complete)

    def look_options(self) -> Iterable[LookOption]:
        from rsb_extras.playing.recordings_here import options  # noqa: PLC0415

        return options()


FEATURE = PlayingFeature()
