"""Frames: a prefix for the frames of what comes in, and stamps on this machine's clock, for the topics that ask."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.feature_api import EntryKey, Feature, SessionKey, ShownField

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.feature_api import Bridge, EnginePart, Extension, Link
    from rsb_console.feature_console import RouteFact

LINK_PREFIX = SessionKey("frame_prefix", str, "", live=True, of_peer=True)
"""Of all topics that come in over a link, unless an entry has its own."""
LINK_RESTAMP = SessionKey("restamp", bool, False, live=True, of_peer=True)
RESTAMP_WITHIN = SessionKey("restamp_within", float, 0.1, live=True)
"""s: the largest error of the clocks' difference with which stamps are shifted; nodes wait as long for a transform."""
PREFIX: EntryKey[str | None] = EntryKey(
    "frame_prefix", str, None, "Frame prefix", "Before the frames of what comes in: robot1/. Empty: as the link says.",
    kinds="topics",
)  # fmt: skip
RESTAMP: EntryKey[bool | None] = EntryKey(
    "restamp", bool, None, "Restamp", "Shift the stamps of what comes in to this machine's clock.", kinds="topics"
)


class Rewriting(msgspec.Struct, frozen=True, omit_defaults=True):
    """The changes to what comes in on a topic.

    Attributes:
        prefix: before frames, or empty.
        restamps: whether stamps are shifted now.
    """

    prefix: str = ""
    restamps: bool = False


REWRITTEN: ShownField[Rewriting] = ShownField("rewritten", Rewriting, Rewriting())


class FramesFeature(Feature):
    name = "frames"

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        return LINK_PREFIX, LINK_RESTAMP, RESTAMP_WITHIN

    def topic_keys(self) -> Iterable[EntryKey[Any]]:
        return PREFIX, RESTAMP

    def problems(self, session: Any) -> Iterable[tuple[str, str]]:
        from rsb_extras.frames import frame_rules  # noqa: PLC0415 -- `Feature` says why, here and below

        return frame_rules.problems(session)

    def topic_problems(self, topic: Any) -> Iterable[tuple[str, str]]:
        from rsb_extras.frames import frame_rules  # noqa: PLC0415

        return frame_rules.topic_problems(topic)

    def effects(self, session: Any) -> Iterable[str]:
        from rsb_extras.frames import frame_rules  # noqa: PLC0415

        return frame_rules.effects(session)

    def extensions(self, link: Link) -> Iterable[Extension]:
        from rsb_extras.frames.link_frames import LinkFrames  # noqa: PLC0415

        return (LinkFrames(link),)

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.frames.link_frames import FramesPart  # noqa: PLC0415

        return (FramesPart(),)

    def route_facts(self) -> Iterable[RouteFact]:
        from rsb_extras.frames.frame_lines import FACT  # noqa: PLC0415

        return (FACT,)


FEATURE = FramesFeature()
