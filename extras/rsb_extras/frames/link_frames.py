"""The frames and the stamps of one link's messages, which are rewritten as they come in."""

from __future__ import annotations

import asyncio
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.cdr.description import DescriptionError, read_description
from rsb_bridge.feature_api import (
    EnginePart,
    Extension,
    Level,
    LinkError,
    MessageTransform,
    Receiver,
    State,
    TransformError,
    Verdict,
    Wording,
)
from rsb_extras.frames import LINK_PREFIX, LINK_RESTAMP, PREFIX, RESTAMP, RESTAMP_WITHIN, REWRITTEN, Rewriting
from rsb_extras.frames.message_rewriter import Rewriter, UnknownTypeError, compile_plan

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Mapping

    from rsb_bridge.feature_api import Link, Route
    from rsb_extras.frames.message_rewriter import RewritePlan

_PLANS = 256  # types whose plans are kept, as many as a link may have that are not installed here
_LOOKS_AGAIN_AFTER = 10.0  # s until a type is looked for again that neither side could describe
_CLOCK_WITHIN, _LOOKS_EVERY = 2.0, 0.05
"""s that an opening waits for the first measurement of the clocks, one round trip after the link; and between looks."""
_HELD = 2
"""Times `restamp_within` up to which the error may grow while stamps are shifted: where it goes up and down around the
bound, they would jump each time by the whole difference."""
_NANOSECONDS = 10**9


class FramesCode(StrEnum):
    """Codes of the events of this feature."""

    RESTAMPS = "frames.restamps"
    RESTAMPS_NOT = "frames.restamps_not"


class FramesCause(StrEnum):
    CLOCK = "frames.clock"
    NOT_DESCRIBED = "frames.not_described"


class FramesText(Wording):
    """Texts about what is not rewritten."""

    UNKNOWN = "not restamped: the other side's clock is not measured yet"
    UNSURE = (
        "not restamped: the other side's clock is known to ±{error:.2g} s only, and restamp_within is {within:g} s: "
        "set that higher, or synchronize the clocks"
    )
    RESTAMPS = "stamps are shifted by {shift:+.3f} s (±{error:.3g} s)"
    NOT_DESCRIBED = (
        "not published, as its frames and stamps cannot be found: {reason}: install the type on either side, "
        "or switch frame_prefix and restamp off for the topic"
    )
    STAMP_NOT_DESCRIBED = (
        "not restamped: {reason}: install the type on either side, or switch restamp off for the topic"
    )
    TOO_MANY = (
        "this link's messages have more strings and sequences than are read in a second: send less, "
        "or switch frame_prefix and restamp off for some topics"
    )


class _Wish(NamedTuple):
    """What is rewritten in a topic's messages, or nothing."""

    prefix: str
    restamp: bool


class StampShift:
    """The time by which stamps of a link's peer are shifted.

    It stays until the clocks' measured difference contradicts it, so that stamps of one stream keep their distances.

    Attributes:
        shift: ns, or None if it is not known well enough.
        problem: the reason, or an empty string.
    """

    def __init__(self) -> None:
        self.shift: int | None = None
        self.problem = FramesText.UNKNOWN()
        self._offset = 0.0

    def look(self, offset: float | None, error: float | None, within: float) -> None:
        """Take the peer's clock minus this one's and its error (s), or None where it is not measured."""
        if offset is None or error is None:
            self.shift, self.problem = None, FramesText.UNKNOWN()
        elif error > (within if self.shift is None else _HELD * within):
            self.shift, self.problem = None, FramesText.UNSURE(error=error, within=within)
        else:
            if self.shift is None or abs(offset - self._offset) > error:
                self._offset = offset
            self.shift, self.problem = -round(self._offset * _NANOSECONDS), ""


class FrameTransform(MessageTransform):
    """Rewrites one topic's messages."""

    def __init__(self, link: Link, plan: RewritePlan, wish: _Wish, type_hash: str, stamps: StampShift) -> None:
        self.restamps, self.prefix = wish.restamp, wish.prefix
        self._same = wish, type_hash
        self._link, self._stamps = link, stamps
        self._rewriter = Rewriter(plan, wish.prefix)
        self.judge()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FrameTransform) and other._same == self._same

    __hash__ = None  # type: ignore[assignment]

    @property
    def corrects_stamps(self) -> bool:  # type: ignore[override]  # it comes and goes with the measured clock
        return self.restamps and self._stamps.shift is not None

    def judge(self) -> None:
        """Note why stamps stay as they are, if they do."""
        problem = self._stamps.problem if self.restamps else ""
        self.verdict = Verdict(State.OK, FramesCause.CLOCK, problem) if problem else None

    def change(self, content: bytes) -> bytes:
        budget, now = self._link.budget.checks, self._link.context.now()
        if budget.left(now) <= 0:
            raise TransformError(FramesText.TOO_MANY())
        self._rewriter.shift = (self._stamps.shift or 0) if self.restamps else 0
        try:
            return self._rewriter.rewrite(content)
        finally:
            budget.spend(self._rewriter.steps, now)


class NotDescribed(MessageTransform):
    """Stands for what cannot be rewritten, as nobody describes the type: a note, or with a prefix a fault.

    With the frames of another robot, messages would do harm; with their own stamps, they are what they are without
    a measured clock.
    """

    def __init__(self, reason: str, wish: _Wish) -> None:
        self._keeps_back = bool(wish.prefix)
        if self._keeps_back:
            self._text = FramesText.NOT_DESCRIBED(reason=reason)
        else:
            self._text = FramesText.STAMP_NOT_DESCRIBED(reason=reason)
        self.verdict = Verdict(State.DOWN if self._keeps_back else State.OK, FramesCause.NOT_DESCRIBED, self._text)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, NotDescribed) and other._text == self._text

    __hash__ = None  # type: ignore[assignment]

    def change(self, content: bytes) -> bytes:
        if self._keeps_back:
            raise TransformError(self._text)
        return content


class LinkFrames(Extension):
    """Looks for what is rewritten in the messages that come in over a link."""

    def __init__(self, link: Link) -> None:
        self.transform = self._transform
        self._link = link
        self._plans: dict[tuple[str, bool, bool], RewritePlan | None] = {}  # by hash, frames, stamps
        self._stamps = StampShift()
        self._of_link: _Wish | None = None  # as of the last look; rights are there only once the link is made
        self._not_described: set[str] = set()  # keys of routes
        self._looks_at = 0.0
        self._restamps = False  # whether any topic has asked for it so far
        self._logged: bool | None = None  # whether the clock was known, as the log has it

    def _wish_of_link(self) -> _Wish:
        rights = self._link.end.rights
        return _Wish(LINK_PREFIX.of(rights), LINK_RESTAMP.of(rights))

    def _wish(self, route: Route) -> _Wish:
        link, prefix, restamp = self._wish_of_link(), PREFIX.of(route.spec), RESTAMP.of(route.spec)
        return _Wish(link.prefix if prefix is None else prefix, link.restamp if restamp is None else restamp)

    def _transform(self, route: Route) -> Callable[[], Awaitable[MessageTransform | None]] | None:
        wish = self._wish(route)
        return partial(self._find, route, wish) if any(wish) else None

    def route_fields(self, route: Route) -> Mapping[str, Rewriting]:
        for each in route.half.path.transforms if isinstance(route.half, Receiver) else ():
            if isinstance(each, FrameTransform):
                return {REWRITTEN.name: Rewriting(each.prefix, each.corrects_stamps)}
        return {}

    async def _find(self, route: Route, wish: _Wish) -> MessageTransform | None:
        type_hash = route.half.carried.type_hash
        key = type_hash, bool(wish.prefix), wish.restamp
        if key not in self._plans:
            try:
                description = read_description(await self._link.type_questions.describe(route), type_hash)
                plan = compile_plan(description, frames=bool(wish.prefix), stamps=wish.restamp)
            except (LinkError, DescriptionError, UnknownTypeError) as error:
                self._not_described.add(route.key)
                return NotDescribed(str(error), wish)
            if len(self._plans) >= _PLANS:
                self._plans.clear()
            self._plans[key] = plan
        if (plan := self._plans[key]) is None:
            return None
        if wish.restamp:
            self._restamps = True
            await self._measured()
        return FrameTransform(self._link, plan, wish, type_hash, self._stamps)

    async def _measured(self) -> None:
        """Wait until the clocks are measured, but not for long."""
        until = self._link.context.now() + _CLOCK_WITHIN
        while self._link.clock.offset is None and self._link.context.now() < until:  # noqa: ASYNC110 -- see below
            await asyncio.sleep(_LOOKS_EVERY)  # pings tell nobody when they are answered
        self._look_at_clock()

    def tick(self) -> None:
        if (wish := self._wish_of_link()) != self._of_link:  # at first, and after a reload
            self._of_link = wish
            for route in self._link.routes.values():
                _choose(route)
        if self._not_described and self._link.context.now() >= self._looks_at:
            self._looks_at = self._link.context.now() + _LOOKS_AGAIN_AFTER
            keys, self._not_described = self._not_described, set()
            for route in (self._link.routes[key] for key in keys if key in self._link.routes):
                _choose(route)
        self._look_at_clock()

    def _look_at_clock(self) -> None:
        clock, before = self._link.clock, self._stamps.problem
        self._stamps.look(clock.offset, clock.uncertainty, RESTAMP_WITHIN.of(self._link.context.session))
        if self._stamps.problem != before:
            for route, each in self._transforms():
                if each.restamps:
                    each.judge()
                    route.judge_again()
        if not self._restamps or clock.offset is None or clock.uncertainty is None:
            return
        if (known := self._stamps.shift is not None) == self._logged:
            return
        self._logged = known
        if self._stamps.shift is None:
            self._link.log_of_peer(Level.WARNING, FramesCode.RESTAMPS_NOT, self._stamps.problem)
        else:
            text = FramesText.RESTAMPS(shift=self._stamps.shift / _NANOSECONDS, error=clock.uncertainty)
            self._link.log_of_peer(Level.INFO, FramesCode.RESTAMPS, text)

    def _transforms(self) -> Iterator[tuple[Route, FrameTransform]]:
        for route in self._link.routes.values():
            if isinstance(route.half, Receiver):
                yield from ((route, each) for each in route.half.path.transforms if isinstance(each, FrameTransform))


def _choose(route: Route) -> None:
    if isinstance(route.half, Receiver):
        route.half.choose_transforms()


class FramesPart(EnginePart):
    """Says that a running bridge takes new values: `LinkFrames` reads them each second."""

    def __init__(self) -> None:
        super().__init__()
        self.by_key = (((LINK_PREFIX.name, LINK_RESTAMP.name, RESTAMP_WITHIN.name), lambda: None),)
