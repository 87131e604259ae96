"""Says what a pattern that matches nothing may mean: a similar name, or one that goes the other way."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.proposals import KINDS
from rsb_bridge.link.questions import AskingExtension, Questions
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.patterns import Pattern, is_valid
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.ros_graph import Meant, MeantNames, name_meant
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.wire.messages import AskMeant, MeantName

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.pattern_matches import PatternEntry

_ASKED_EVERY = 60.0
"""s until the other side is asked again about a pattern. A round figure: some 100 bytes cross for it."""
_ANSWERED_WITHIN = 10.0  # s. A round figure: nobody waits for it
_A_SECOND = 1.0  # answers to the other side: each searches the graph (PROTOCOL.md, 3)


class MeaningText(Wording):
    """The ends of the reason why a pattern waits."""

    NEAR = "; did you mean {name}?"
    OTHER_WAY = "; {name} is {offered} {where}: direction: {direction}?"
    NEAR_OTHER_WAY = "; {name} is {offered} {where}: direction: {direction}, and that name?"


def _names_here(context: Context) -> MeantNames:
    return MeantNames(context.ros, context.loop)


class PatternHints(AskingExtension):
    """Searches both graphs for what patterns may mean, and answers the other side's questions."""

    def __init__(self, link: BaseLink) -> None:
        self._link = link
        self._here = link.context.shared(_names_here)
        self._there: dict[Meant, tuple[str, float]] = {}  # answers, and when (s) each was asked for
        self._number = 0
        self.messages = {AskMeant: self._asked, MeantName: self._answered}
        self._questions: Questions[str] = Questions(link, _ANSWERED_WITHIN, a_second=_A_SECOND)

    def of(self, entry: PatternEntry) -> str:
        """Return the end of a sentence about a pattern that matches nothing, or an empty string."""
        link, kind = self._link, entry.topic.kind
        routes = [each for each in link.routes.values() if each.spec.kind == kind]
        follows_here = entry.from_client == link.is_client
        here, there = (entry.name_of(entry.topic, on_client=side) for side in (link.is_client, not link.is_client))
        found_here = self._here.of(Meant(kind, here, matching=not follows_here), lambda: None)
        found_there = self._of_peer(Meant(kind, there, matching=follows_here))
        # What crosses already is meant by another entry.
        found_here = "" if any(each.local_topic == found_here for each in routes) else found_here
        found_there = "" if any(each.far_topic == found_there for each in routes) else found_there
        near, other, pattern = (found_here, found_there, there) if follows_here else (found_there, found_here, here)
        direction = "receive" if entry.topic.direction == "transmit" else "transmit"
        about = {
            "name": other,
            "offered": "published" if kind == "topic" else "provided",
            "where": "on the other side" if follows_here else "here",
            "direction": direction,
        }
        if other and Pattern(pattern).match(other) is not None:
            return MeaningText.OTHER_WAY(**about)
        if near:
            return MeaningText.NEAR(name=near)
        return MeaningText.NEAR_OTHER_WAY(**about) if other else ""

    def _of_peer(self, asked: Meant) -> str:
        """Return the newest answer of the other side, and ask it now and then."""
        name, at = self._there.get(asked, ("", float("-inf")))
        now = self._link.context.now()
        if self._link.linked and now - at >= _ASKED_EVERY:
            self._there[asked] = name, now
            self._number += 1
            self._link.spawn(self._ask(AskMeant(self._number, asked.pattern, asked.kind, asked.matching), asked))
        return name

    async def _ask(self, question: AskMeant, asked: Meant) -> None:
        with suppress(LinkError):  # a hint is worth no error
            self._there[asked] = await self._questions.ask(question.number, question), self._link.context.now()

    def disconnected(self) -> None:
        super().disconnected()
        self._there.clear()

    # --- the other side's patterns

    def _asked(self, question: AskMeant) -> None:
        self._questions.answer(question.number, partial(self._find, question))

    def _answered(self, message: MeantName) -> None:
        self._questions.answered(message.number, message.name)

    async def _find(self, question: AskMeant) -> MeantName:
        name, shows = "", self._link.end.shows
        kind = KINDS.get(question.kind)
        if kind is not None and is_valid(question.pattern):
            asked = Meant(kind, question.pattern, matching=question.matching)
            with suppress(RosError):
                name = await name_meant(
                    self._link.context.ros, asked, lambda name: len(name) <= TEXT_LENGTH and shows(name, kind)
                )
        return MeantName(question.number, name)
