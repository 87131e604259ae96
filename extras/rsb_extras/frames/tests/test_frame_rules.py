"""The keys of frames and stamps in session files: their mistakes, each with its place, and what `check` says."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.support.wording import says

from rsb_bridge.config.session_file import load, save
from rsb_bridge.config.validation import build
from rsb_bridge.installed_features import added
from rsb_bridge.model.session import Client, Topic
from rsb_extras.frames import LINK_PREFIX, PREFIX, RESTAMP, RESTAMP_WITHIN
from rsb_extras.frames.frame_rules import FrameRulesText

if TYPE_CHECKING:
    from pathlib import Path

CLIENT = {
    "name": "a", "role": "client", "server_ip": "10.0.0.1", "server_port": 7060, "use_encryption": False,
}  # fmt: skip
SERVER = CLIENT | {"role": "server"}


def mistakes(session: dict[str, Any]) -> list[tuple[str, str]]:
    return [(problem.location, problem.message) for problem in build(session)[1]]


@pytest.mark.parametrize("prefix", ["robot1", "/robot1/", "a b/", "/", "ü/", "x" * 64 + "/", "a\n/"])
def test_a_prefix_that_makes_no_frames_is_a_mistake(prefix: str) -> None:
    entry = {"topic": "/tf", "direction": "receive", "frame_prefix": prefix}
    server = SERVER | {"clients": [{"name": "r", "frame_prefix": prefix}]}
    for session, place in (
        (CLIENT | {"frame_prefix": prefix}, "frame_prefix"),
        (CLIENT | {"topics": [entry]}, "topics[0].frame_prefix"),
        (server, "clients[0].frame_prefix"),
    ):
        (found,) = mistakes(session)
        assert found[0] == place
        assert says(found[1], FrameRulesText.PREFIX)


@pytest.mark.parametrize("prefix", ["robot1/", "r_", "fleet/robot-1/", "a-", ""])
def test_a_prefix_is_taken(prefix: str) -> None:
    session, problems = build(CLIENT | {"frame_prefix": prefix})
    assert not problems
    assert LINK_PREFIX.of(session) == prefix


def test_keys_where_a_topic_is_sent_are_a_mistake() -> None:
    sent = [{"topic": "/tf", "direction": "transmit", "restamp": True}]
    ((place, text),) = mistakes(CLIENT | {"topics": sent})
    assert place == "topics[0].restamp"
    assert text == FrameRulesText.SENT(topic="/tf")
    assert not mistakes(SERVER | {"clients": [{"name": "r", "topics": sent}]})
    received = [{"topic": "/tf", "direction": "receive", "frame_prefix": "a/"}]
    ((place, _),) = mistakes(SERVER | {"clients": [{"name": "r", "topics": received}]})
    assert place == "clients[0].topics[0].frame_prefix"


@pytest.mark.parametrize("within", [0, 11, -1])
def test_a_bound_of_the_clocks_error_is_limited(within: float) -> None:
    ((place, _),) = mistakes(CLIENT | {"restamp_within": within})
    assert place == RESTAMP_WITHIN.name


def test_check_says_what_the_links_do() -> None:
    session, _ = build(SERVER | {"clients": [{"name": "r1", "frame_prefix": "r1/"}, {"name": "r2", "restamp": True}]})
    lines = added("effects", session)
    assert FrameRulesText.PREFIXES(peer="r1", prefix="r1/") in lines
    assert FrameRulesText.RESTAMPS(peer="r2", within=0.1) in lines


def test_a_file_keeps_what_an_entry_turns_off(tmp_path: Path) -> None:
    path = tmp_path / "pc.yaml"
    off = Topic("/a", "transmit", features={"frame_prefix": "", "restamp": False})
    session, _ = build(SERVER)
    save(session.with_clients((Client("r", topics=(off,), features={"frame_prefix": "r/", "restamp": True}),)), path)
    (topic,) = load(path).listed_clients[0].topics
    assert (PREFIX.of(topic), RESTAMP.of(topic)) == ("", False)
