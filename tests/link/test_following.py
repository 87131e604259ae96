"""The lists that a side sends to a peer that follows its graph, for all requests; and a pattern's use of names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import pytest

from rsb_bridge.link.extension import LinkError
from rsb_bridge.link.link_patterns import PeerSubscription
from rsb_bridge.link.pattern_matches import PatternEntry
from rsb_bridge.link.proposals import authorized
from rsb_bridge.model.patterns import NAMES_FOLLOWED
from rsb_bridge.model.session import Topic
from rsb_bridge.wire.messages import Follow, Followed, FoundName, NamePattern, Propose

if TYPE_CHECKING:
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.graph_watch import Names

TYPE = "std_msgs/msg/String"


class Side:
    def __init__(self) -> None:
        self.sent: list[Followed] = []
        self.followed: PeerSubscription | None = None
        self.end = self

    def shows(self, name: str, _: str) -> bool:
        return "secret" not in name

    def send(self, message: object) -> None:
        assert isinstance(message, Followed)
        self.sent.append(message)

    def look(self, names: Names) -> list[Followed]:
        self.sent.clear()
        if self.followed is not None:
            self.followed.patterns_here()
            self.followed.update_names(names)
        return self.sent

    def ask(self, *patterns: NamePattern, request: int = 1) -> None:
        self.followed = PeerSubscription(cast("Any", self), Follow(request, patterns))


def topics(*names: str) -> Names:
    return {("topic", name): TYPE for name in names}


def test_first_answer_has_all_next_ones_changes() -> None:
    side = Side()
    side.ask(NamePattern("/a/*"), NamePattern("/s/*", "service"))
    names: Names = {**topics("/a/x", "/a/y", "/b/x", "/a/secret", "/s/topic"), ("service", "/s/call"): ""}
    (told,) = side.look(names)
    assert (told.request, told.gone, told.more) == (1, (), 0)
    assert set(told.present) == {FoundName("/a/x", TYPE), FoundName("/a/y", TYPE), FoundName("/s/call", "", "service")}
    assert side.look(names) == []
    del names["topic", "/a/x"]
    names["topic", "/a/y"] = "another/msg/Type"
    (told,) = side.look(names)
    assert (told.present, told.gone) == ((FoundName("/a/y", "another/msg/Type"),), (FoundName("/a/x"),))


def test_that_nothing_matches_is_an_answer_too() -> None:
    side = Side()
    side.ask(NamePattern("/a/*"), request=7)
    assert side.look({}) == [Followed(7)]
    assert side.look({}) == []
    side.ask(request=8)
    assert side.look(topics("/a/x")) == [Followed(8)]


@pytest.mark.parametrize("pattern", ["/a**", "", "*", "/a/[*", "/a/" + "*" * 9, "no/*"])
def test_what_is_no_pattern_asks_for_nothing(pattern: str) -> None:
    side = Side()
    side.ask(NamePattern(pattern), NamePattern("/a/*", "telepathy"))
    assert side.look(topics("/a/x")) == [Followed(1)]


def test_answers_have_limit_and_stay_told() -> None:
    side = Side()
    side.ask(NamePattern("/**"))
    told = side.look(topics(*(f"/t{n:04}" for n in range(500, 500 + NAMES_FOLLOWED))))
    assert sum(len(each.present) for each in told) == NAMES_FOLLOWED
    assert max(len(each.present) for each in told) < NAMES_FOLLOWED, "no message holds up the others"
    (one,) = side.look(topics(*(f"/t{n:04}" for n in range(500 + NAMES_FOLLOWED))))
    assert (one.present, one.gone, one.more) == ((), (), 500)


@pytest.mark.parametrize("name", ["/a/x y", "/a/1x", "/a/_x", "/a/", "/b/x", "/a/out", "/a/x/y"])
def test_name_nobody_asked_for_is_no_topic(name: str) -> None:
    """For anything in the peer's list."""
    entry = PatternEntry(Topic("/a/*", "receive", excepts=("/a/out",)), client="robot1", prefixed=False)
    assert entry.match(name, TYPE) is None


@pytest.mark.parametrize(
    ("remote", "prefixed", "always_prefixed", "source", "name", "made"),
    [
        (None, False, False, "/a/*", "/a/x", ("/a/x", None)),
        (None, True, False, "/robot1/a/*", "/robot1/a/x", ("/a/x", None)),
        (None, False, True, "/robot1/a/*", "/robot1/a/x", ("/a/x", None)),
        ("/b/*", True, False, "/b/*", "/b/x", ("/a/x", "/b/x")),
        ("/b/*", False, True, "/robot1/b/*", "/robot1/b/x", ("/a/x", "/b/x")),
        ("/robot1/*", False, True, "/robot1/*", "/robot1/x", ("/a/x", "/robot1/x")),
    ],
)
def test_servers_names_are_those_of_future_routes(
    remote: str | None, prefixed: bool, always_prefixed: bool, source: str, name: str, made: tuple[str, str | None]
) -> None:
    pattern = Topic("/a/*", "receive", remote_topic=remote)
    entry = PatternEntry(pattern, client="robot1", prefixed=prefixed, always_prefixed=always_prefixed)
    assert entry.source.text == source
    topic = entry.match(name, TYPE)
    assert topic is not None
    assert (topic.topic, topic.remote_topic) == made


@pytest.mark.parametrize("names", [("/a/*", "/a/*"), ("/a", "/a/**"), ("/**", "/a")])
def test_a_peer_proposes_no_patterns(names: tuple[str, str]) -> None:
    proposal = Propose(route=1, topic=names[0], remote_topic=names[1], from_client=True)
    with pytest.raises(LinkError, match="pattern"):
        authorized(proposal, cast("BaseLink", None))
