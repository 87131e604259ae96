"""The type that is sent if session, publishers and the other side's graph differ."""

from __future__ import annotations

import gc
import weakref
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest

from rsb_bridge.cdr.description import TypeVersion
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Direction, Topic
from rsb_bridge.ros.ros_interface import Endpoint
from rsb_bridge.route.listeners import PublishedAs
from rsb_bridge.route.resolving import Resolver, UnresolvedError, choose_type, left_out
from rsb_bridge.wire.messages import Propose

A, B = "std_msgs/msg/String", "std_msgs/msg/Int32"
UNUSED = TypeVersion()


def publisher(type_name: str, version: str = "", node: str = "") -> Endpoint:
    return Endpoint(node, type_name, version, Qos())


def chosen(
    *publishers: Endpoint,
    wanted: str = "",
    used: TypeVersion = UNUSED,
    hint: TypeVersion = UNUSED,
    installed: str | None = None,
) -> TypeVersion:
    return choose_type(publishers, wanted, used, hint, lambda _: installed)


def test_what_the_publishers_have_counts_first() -> None:
    assert chosen(publisher(A, "1"), publisher(A), hint=TypeVersion(B, "2"), installed="3") == (A, "1")
    assert chosen(hint=TypeVersion(B, "2")) == (B, "2")
    assert chosen(hint=TypeVersion(B, "2"), installed="3") == (B, "3")
    assert chosen(wanted=A, hint=TypeVersion(B, "2")) == (A, "")
    assert chosen() == UNUSED


def test_used_version_outlives_its_publisher() -> None:
    assert chosen(wanted=A, used=TypeVersion(A, "1")) == (A, "1")
    assert chosen(wanted=A, used=TypeVersion(B, "1")) == (A, "")


def test_type_of_session_is_sent_regardless() -> None:
    publishers = (publisher(B, "2"), publisher(A, "1"))
    assert chosen(*publishers, wanted=A) == (A, "1")
    assert not left_out(publishers, A, A)
    with pytest.raises(UnresolvedError, match=rf"{B} \(from /b\).*{A}"):
        chosen(publisher(B, "2", "/b"), wanted=A)
    with pytest.raises(UnresolvedError, match=rf"{B} \(from /b\) now, and no longer {A}: correct them"):
        chosen(publisher(B, "2", "/b"), wanted=A, used=TypeVersion(A, "1"))


def test_disagreeing_publishers_leave_type_in_use() -> None:
    publishers = (publisher(A, "1", "/a"), publisher(B, "2", "/b"))
    with pytest.raises(UnresolvedError, match=rf"{B} \(from /b\) and {A} \(from /a\)"):
        chosen(*publishers)
    assert chosen(*publishers, used=TypeVersion(B, "2")) == (B, "2")
    assert f"{A} (from /a)" in left_out(publishers, "", B)
    third = publisher("zoo/msg/C", "3", "/c")
    assert f"{A} (from /a) and zoo/msg/C (from /c) are not bridged, only {B}" in left_out((*publishers, third), "", B)
    assert not left_out(publishers[:1], "", A)


def test_versions_of_one_type_are_not_mixed() -> None:
    """DDS takes them for the same type, so none is sent."""
    publishers = (publisher(A, "1", "/new"), publisher(A, "2", "/old"))
    with pytest.raises(UnresolvedError, match=r"1 \(from /new\) and 2 \(from /old\)"):
        chosen(*publishers, used=TypeVersion(A, "1"))


def test_a_sentence_names_a_few_nodes_and_types() -> None:
    crowd = [publisher(f"{kind}_msgs/msg/X", "", f"/node{number}") for kind in "abcdef" for number in range(9)]
    with pytest.raises(UnresolvedError) as failure:
        chosen(*crowd)
    assert len(str(failure.value)) < 400
    assert "and 6 more" in str(failure.value)
    assert "and 2 more" in str(failure.value)


class Side(SimpleNamespace):
    """A sending side's route of /robot1/scan whose graph has one other topic that may be meant, if any."""

    def __init__(self, meant: str = "", *publishers: Endpoint, lists: Direction = "transmit") -> None:
        ros = SimpleNamespace(publishers=lambda _: self.published, installed_hash=lambda _: None)
        super().__init__(
            published=[*publishers],
            wall=10.0 * 3600,
            context=SimpleNamespace(
                domain="3", wall=lambda: self.wall, similar_topics=SimpleNamespace(of=lambda *_: meant), ros=ros
            ),
            proposal=Propose(route=1, topic="/robot1/scan", remote_topic="/robot1/scan", from_client=True),
            peer=SimpleNamespace(is_client=False, name="robot1"),
            spec=Topic("/robot1/scan", lists),
            far_topic="/robot1/robot1/scan",
            judge_again=lambda: None,
        )

    @property
    def resolver(self) -> Resolver:
        return Resolver(cast("Any", self))


NOBODY = "no publisher of /robot1/scan in domain 3"


def test_similar_name_is_suggested_for_moved_topic() -> None:
    side = Side("/robot1/scam", publisher(A, "1", "/other"))
    resolver = side.resolver
    assert resolver.no_publisher() == f"{NOBODY}; did you mean /robot1/scam?"
    resolver.update([publisher(A, "1", "/talker")])
    assert resolver.elsewhere is None
    resolver.update([])
    assert resolver.elsewhere is None, "another node's topic"
    side.published.append(publisher(A, "1", "/talker"))
    assert resolver.no_publisher() == f"{NOBODY}; did you mean /robot1/scam?", "its publisher's topic has another name"


def test_prefix_that_server_adds_is_named() -> None:
    side = Side("/scan", publisher(A, "1", "/lidar"))
    assert side.resolver.no_publisher() == f"{NOBODY}; did you mean /scan? The server adds /robot1"
    side.far_topic = "/robot1/scan"
    assert side.resolver.no_publisher() == f"{NOBODY}; did you mean /scan?"


@pytest.mark.parametrize("on_client", ["/scan", "/robot1/scan"])
def test_prefix_is_named_where_server_publishes(on_client: str) -> None:
    """The client's entry says receive: it lacks the prefix as it should, or has it beside the server's."""
    side = Side(on_client, publisher(A, "1", "/desk"), lists="receive")
    side.peer.is_client = True
    side.far_topic = on_client
    topic = f"/robot1{on_client}"
    side.proposal = msgspec.structs.replace(side.proposal, topic=topic)
    nobody = NOBODY.replace("/robot1/scan", topic)
    assert side.resolver.no_publisher() == f"{nobody}; did you mean {on_client}? The server adds /robot1"


def test_remapped_topic_is_named_with_its_nodes() -> None:
    side = Side("/front_laser", publisher(A, "1", "/lidar"), publisher(A, "1", "/b"))
    resolver = side.resolver
    assert resolver.no_publisher() == f"{NOBODY}; /b and /lidar publish /front_laser, the same type"
    resolver.update([publisher(A, "1", "/lidar")])
    resolver.update([])
    moved = f"{NOBODY}; /lidar publishes /front_laser since 10:00 UTC, the same type"
    assert resolver.no_publisher() == moved
    side.wall += 600.0
    assert resolver.no_publisher() == moved


@pytest.mark.parametrize(("lists", "meant"), [("transmit", "receive"), ("receive", "transmit")])
def test_publisher_on_other_side_asks_for_other_direction(lists: Direction, meant: str) -> None:
    side = Side(lists=lists)
    resolver = side.resolver
    resolver.published_there = PublishedAs(("/lidar",))
    assert resolver.no_publisher() == f"{NOBODY}; /lidar publishes it on robot1: direction: {meant}?"
    side.peer.is_client = True
    assert "it on the server:" in resolver.no_publisher()


def test_near_name_on_other_side_asks_for_both() -> None:
    side = Side()
    resolver = side.resolver
    resolver.published_there = PublishedAs(("/lidar",), "/scam")
    assert resolver.no_publisher() == f"{NOBODY}; /lidar publishes /scam on robot1: direction: receive, and that name?"


def test_near_name_here_counts_more_than_there() -> None:
    side = Side("/robot1/scam", publisher(A, "1", "/lidar"))
    resolver = side.resolver
    resolver.published_there = PublishedAs(("/desk",), "/scan")
    assert resolver.no_publisher() == f"{NOBODY}; did you mean /robot1/scam?"


def test_a_search_without_a_result_leaves_no_circle() -> None:
    """A kept traceback leads back to the route, which then lasts until garbage is collected, with all that it has."""
    resolver = Side().resolver
    gc.disable()
    try:
        assert resolver.resolve(UNUSED, cast("Any", None)) is None
        assert resolver.why() == NOBODY
        held = weakref.ref(resolver)
        del resolver
        assert held() is None
    finally:
        gc.enable()
