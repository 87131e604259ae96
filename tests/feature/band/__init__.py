"""Bands: rates of topics that operators expect, with a bell when one leaves its band."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from rsb_bridge.feature_api import EntryKey, Feature, SessionKey

if TYPE_CHECKING:
    from collections.abc import Iterable

_RANGE = (0.0, 1000.0)
LOW = EntryKey("band_low", float, None, "Band from", "Hz. Empty: any.", "Hz", _RANGE, "topics", of_peer=True)
HIGH = EntryKey("band_high", float, None, "Band to", "Hz. Empty: any.", "Hz", _RANGE, "topics", of_peer=True)
AFTER = SessionKey("band_after", float, 3.0, live=True)


class Band(Feature):
    API: ClassVar[int] = 1
    name = "band"

    def topic_keys(self) -> Iterable[EntryKey[Any]]:
        return LOW, HIGH

    def topic_problems(self, topic: Any) -> Iterable[tuple[str, str]]:
        low, high = LOW.of(topic), HIGH.of(topic)
        if low is not None and high is not None and low > high:
            yield "band_low", "above band_high: lower it"

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        return (AFTER,)

    def problems(self, session: Any) -> Iterable[tuple[str, str]]:
        if AFTER.of(session) < 0:
            yield "band_after", "give 0 or more seconds"

    def extensions(self, link: Any) -> Iterable[Any]:
        from .bridge import Bands

        return (Bands(link),)

    def parts(self, bridge: Any) -> Iterable[Any]:
        from .bridge import BandPart

        return (BandPart(),)

    def subcommands(self, add: Any, complete: Any) -> None:
        from rsb_console.feature_console import bridge_options, route_arguments, subcommand

        parser = add("watch", subcommand(f"{__name__}.console:watch"), "beep when a topic's rate leaves a band")
        route_arguments(parser, complete)
        parser.add_argument("--low", type=float, default=0.0, help="Hz")
        parser.add_argument("--high", type=float, default=float("inf"), help="Hz")
        parser.add_argument("--once", action="store_true", help="end with exit code 1 when it has left the band")
        bridge_options(parser, complete)

    def actions(self) -> Iterable[Any]:
        from rsb_console.feature_console import Action, Group, late

        run, about = late(f"{__name__}.console:set_band"), "Set the band of a topic's rate"
        return (Action("band", "Z", "band", about, Group.OPERATE, changes=True, needs_topic=True, run=run),)

    def columns(self) -> Iterable[Any]:
        from rsb_console.feature_console import TopicColumn

        return (TopicColumn("BAND", "the band of its rate, Hz", 10, lambda route: shown(route.spec)),)

    def listeners(self, console: Any) -> Iterable[Any]:
        from .console import Ringer

        return (Ringer(console).hear,)


def shown(topic: Any) -> str:
    """Return a topic's band, ``8-12``, or an empty string."""
    low, high = LOW.of(topic), HIGH.of(topic)
    if low is None and high is None:
        return ""
    return f"{'' if low is None else f'{low:g}'}-{'' if high is None else f'{high:g}'}"


def outside(rate: float, low: float | None, high: float | None) -> str:
    """Return how a rate (Hz) is outside of a band, or an empty string."""
    if low is not None and rate < low:
        return f"{rate:.3g} Hz, below {low:g}"
    if high is not None and rate > high:
        return f"{rate:.3g} Hz, above {high:g}"
    return ""


FEATURE = Band()
