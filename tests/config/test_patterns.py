"""Patterns in session files: what is wrong with one, how they are saved, and what `check` says of them."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from rsb_bridge.config.rights_listing import listings
from rsb_bridge.config.session_changes import changes
from rsb_bridge.config.session_file import SessionError, load_file, parse, save
from rsb_bridge.config.validation import validate_topic
from rsb_bridge.model.patterns import EXCEPTIONS_PER_PATTERN, PATTERNS_PER_LINK
from rsb_bridge.model.session import Session, Topic

HEAD = "name: robot1\nrole: client\nserver_ip: 10.0.0.1\nserver_port: 49152\nkey_file: key.txt\n"
WRITTEN = """\
topics:
  # all cameras
  - {topic: /camera/**, direction: transmit, except: [/camera/**/compressed]}  # but no previews
  - {topic: /*, direction: receive, remote_topic: /robot1/*}
services:
  - service: /nav/*
    provider: client
    except: [/nav/debug]
"""


def read(text: str) -> Session:
    return parse(HEAD + text, Path("robot1.yaml"))


def locations(topic: Topic, session: Session | None = None) -> set[str]:
    return {problem.location for problem in validate_topic(topic, session)}


def test_patterns_are_read() -> None:
    assert read(WRITTEN).topics == (
        Topic("/camera/**", "transmit", excepts=("/camera/**/compressed",)),
        Topic("/*", "receive", remote_topic="/robot1/*"),
        Topic("/nav/*", "receive", kind="service", excepts=("/nav/debug",)),
    )


@pytest.mark.parametrize(
    ("topic", "where"),
    [
        (Topic("/a**", "transmit"), "topic"),
        (Topic("/a?*", "transmit"), "topic"),
        (Topic("a/*", "transmit"), "topic"),
        (Topic("/_hidden/*", "transmit"), "topic"),
        (Topic(f"/{'a' * 250}*", "transmit"), "topic"),
        (Topic("/a/*", "transmit", remote_topic="/a/**"), "remote_topic"),
        (Topic("/a/*/*", "transmit", remote_topic="/a/*"), "remote_topic"),
        (Topic("/a/**/*", "transmit", remote_topic="/a/*/**"), "remote_topic"),
        (Topic("/a/*", "transmit", remote_topic="/a"), "remote_topic"),
        (Topic("/a", "transmit", remote_topic="/a/*"), "remote_topic"),
        (Topic("/a/*", "transmit", remote_topic="/_a/*"), "remote_topic"),
        (Topic("/a/*", "transmit", port=12001), "port"),
        (Topic("/a/*", "transmit", protocol="udp", port=12001), "port"),
        (Topic("/a", "transmit", excepts=("/b",)), "except"),
        (Topic("/a/*", "transmit", excepts=("b",)), "except[0]"),
        (Topic("/a/*", "transmit", excepts=("/a/b", "/a/**c")), "except[1]"),
        (Topic("/a/*", "transmit", excepts=("/a/b",) * (EXCEPTIONS_PER_PATTERN + 1)), "except"),
        (Topic("/nav/**x", "receive", kind="service"), "service"),
        (Topic("/nav/*", "receive", kind="action", remote_topic="/nav"), "remote_action"),
        (Topic("/*", "receive", kind="parameters", protocol="udp"), "protocol"),
    ],
    ids=lambda value: value.topic if isinstance(value, Topic) else value,
)
def test_mistake_is_at_key_that_has_it(topic: Topic, where: str) -> None:
    assert locations(topic) == {where}


@pytest.mark.parametrize(
    "topic",
    [
        Topic("/a/**/b*", "transmit", remote_topic="/x/**/*y"),
        Topic("/a/*", "transmit", type="Image", max_rate=5.0, excepts=("/a/_hidden", "/a/b", "/a/c*")),
        Topic("/a/*", "transmit", protocol="bluetooth", port=5),
        Topic("/**", "receive", kind="action", timeout=3.0),
    ],
    ids=lambda topic: topic.topic,
)
def test_what_is_right_has_no_mistakes(topic: Topic) -> None:
    bluetooth = Session(
        name="r", role="client", server_ip="10.0.0.1", server_port=49152, bluetooth_address="5C:F3:70:9A:1B:2E"
    )
    assert locations(topic, bluetooth) == set()


def test_repeated_patterns_merge_too_many_are_refused() -> None:
    with pytest.raises(SessionError) as caught:
        read("topics:\n" + "  - {topic: /a/*, direction: transmit}\n" * 2)
    assert [problem.location for problem in caught.value.problems] == ["topics[1]"]
    many = "".join(f"  - {{topic: /a{n}/*, direction: transmit}}\n" for n in range(PATTERNS_PER_LINK + 1))
    with pytest.raises(SessionError) as caught:
        read(f"topics:\n{many}")
    assert [problem.location for problem in caught.value.problems] == [f"topics[{PATTERNS_PER_LINK}]"]


def test_a_single_topic_is_no_pattern() -> None:
    with pytest.raises(SessionError) as caught:
        read("shutdown_topic: /a/*\n")
    assert [problem.location for problem in caught.value.problems] == ["shutdown_topic"]


def test_an_exception_is_saved_in_its_place(tmp_path: Path) -> None:
    """For example when an operator has removed one topic that a pattern had brought."""
    path = tmp_path / "robot1.yaml"
    path.write_text(HEAD + WRITTEN)
    opened = load_file(path)
    camera, every, nav = opened.session.topics
    camera = replace(camera, excepts=(*camera.excepts, "/camera/left"))
    every = replace(every, excepts=("/cmd_vel",))
    save(replace(opened.session, topics=(camera, every, nav)), path, opened)
    assert path.read_text() == HEAD + WRITTEN.replace(
        "[/camera/**/compressed]", "[/camera/**/compressed, /camera/left]"
    ).replace("/robot1/*}", "/robot1/*, except: [/cmd_vel]}")


def test_exceptions_are_told_as_the_file_has_them() -> None:
    pattern = Topic("/a/*", "transmit")
    assert changes(pattern, replace(pattern, excepts=("/a/b",))) == ["except [] → [/a/b]"]


@pytest.mark.parametrize(("topic", "moves"), [("/**", True), ("/cmd_*", True), ("/camera/*", False)])
def test_receiver_by_pattern_is_told_what_moves_robot(topic: str, moves: bool) -> None:
    (listing,) = listings(read(f"topics:\n  - {{topic: {topic}, direction: receive}}\n"))
    assert ("/cmd_vel" in listing.moves) == moves
    (listing,) = listings(read(f"topics:\n  - {{topic: {topic}, direction: transmit}}\n"))
    assert listing.moves == ()
