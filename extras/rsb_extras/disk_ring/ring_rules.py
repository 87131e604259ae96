"""Rules on the bounds of the ring on disk, advice on them, and what they mean."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Range, Wording
from rsb_bridge.model.patterns import is_valid
from rsb_extras.recording import RECORD, RecordLimits, record_limits
from rsb_extras.recording.record_rules import RecordText

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.feature_api import Session

# Round figures.
LONGEST_STRETCH = 600.0
"""s of a stretch after its first occasion: a fault may come and go for ever."""
DISK = Range(0.01, 100_000)
"""GB: a hundredth is a minute of a robot without cameras."""
RANGES = {
    "disk": DISK,
    "disk_seconds": Range(10, 31_536_000),
    "free": Range(0, 100_000),
    "before": Range(0, 86_400),
    "after": Range(0, LONGEST_STRETCH),
    "kept": DISK,
}
_OFF_AT_ZERO = ("disk", "disk_seconds")
_NAMES = 64  # under `also`. A round figure


class RingRuleText(Wording):
    NEEDS_DISK = "it is about the ring on disk: set record.disk, too"
    NOT_A_NAME = "{name!r} is neither a topic's name nor a pattern such as /camera/**"
    TOO_MANY = "{count} names and patterns: at most {most}"
    ALSO = "each topic is subscribed to here, and its messages come to the bridge, which costs what bridging one costs"
    EFFECT = "{disk:g} GB of what passes on disk; kept are {before:g} s before and {after:g} s after: {causes}"
    EFFECT_ALSO = "and of this side's domain: {names}"


def problems(session: Session) -> Iterator[tuple[str, str]]:
    """Yield the mistakes, as `Feature.problems`."""
    limits = record_limits(session)
    if limits is None:
        return
    for name, allowed in RANGES.items():
        value = getattr(limits, name)
        if value not in allowed and not (value == 0 and name in _OFF_AT_ZERO):
            yield f"{RECORD.name}.{name}", RecordText.OUT_OF_RANGE(value=value, range=allowed)
        elif not limits.disk and value != getattr(RecordLimits(), name):
            yield f"{RECORD.name}.{name}", RingRuleText.NEEDS_DISK()
    also = f"{RECORD.name}.also"
    if limits.also and not limits.disk:
        yield also, RingRuleText.NEEDS_DISK()
    if len(limits.also) > _NAMES:
        yield also, RingRuleText.TOO_MANY(count=len(limits.also), most=_NAMES)
    for each in limits.also:
        if not is_valid(each):
            yield also, RingRuleText.NOT_A_NAME(name=each)


def advice(session: Session) -> Iterator[tuple[str, str]]:
    """Yield advice, as `Feature.advice`."""
    limits = record_limits(session)
    if limits is not None and limits.also:
        yield f"{RECORD.name}.also", RingRuleText.ALSO()


def effects(session: Session) -> Iterator[str]:
    """Yield what it does, as `Feature.effects`."""
    limits = record_limits(session)
    if limits is None or not limits.disk:
        return
    causes = ", ".join((*limits.keep_on, "E"))
    yield f"{RECORD.name}: " + RingRuleText.EFFECT(
        disk=limits.disk, causes=causes, before=limits.before, after=limits.after
    )
    if limits.also:
        yield f"{RECORD.name}: " + RingRuleText.EFFECT_ALSO(names=", ".join(limits.also))
