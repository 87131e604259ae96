"""The type that is sent if session, publishers and the other side's graph differ."""

from __future__ import annotations

import gc
import weakref
from types import SimpleNamespace
from typing import Any, cast

import pytest

from rsb_bridge.cdr.description import TypeVersion
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import Endpoint
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


def test_similar_name_is_suggested_for_moved_topic() -> None:
    elsewhere = [publisher(A, "1", "/other")]
    context = cast(
        "Any",
        SimpleNamespace(
            domain="3",
            similar_topics=SimpleNamespace(of=lambda *_: "/chart"),
            ros=SimpleNamespace(publishers=lambda topic: elsewhere),
        ),
    )
    resolver = Resolver(context, Propose(route=1, topic="/chat", remote_topic="/chat", from_client=True), lambda: None)
    assert resolver.no_publisher() == "no publisher of /chat in domain 3; did you mean /chart?"
    resolver.update([publisher(A, "1", "/talker")])
    assert resolver.similar == ""
    resolver.update([])
    assert resolver.similar == "", "another node's topic"
    elsewhere.append(publisher(A, "1", "/talker"))
    assert resolver.similar == "/chart", "its publisher has another name for it now"


def test_a_search_without_a_result_leaves_no_circle() -> None:
    """A kept traceback leads back to the route, which then lasts until garbage is collected, with all that it has."""
    ros = SimpleNamespace(publishers=lambda topic: [], installed_hash=lambda type_name: None)
    context = cast("Any", SimpleNamespace(domain="3", similar_topics=SimpleNamespace(of=lambda *_: ""), ros=ros))
    resolver = Resolver(context, Propose(route=1, topic="/chat", remote_topic="/chat", from_client=True), lambda: None)
    gc.disable()
    try:
        assert resolver.resolve(UNUSED, cast("Any", None)) is None
        assert resolver.why() == "no publisher of /chat in domain 3"
        held = weakref.ref(resolver)
        del resolver
        assert held() is None
    finally:
        gc.enable()
