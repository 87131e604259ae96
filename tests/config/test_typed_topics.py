"""A topic whose values are of the right kinds is judged as the same entry of a file: no more and no less is refused."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from tests.config.typed_topics_helpers import FIELDS, KEY

from rsb_bridge.config.decoding import ValueMistake
from rsb_bridge.config.file_form import LISTS
from rsb_bridge.config.topic_rules import entry_problems
from rsb_bridge.config.validation import validate
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.session import Problem, Session, Topic

topics = st.lists(
    st.sampled_from(list(FIELDS)).flatmap(lambda name: st.tuples(st.just(name), FIELDS[name])), max_size=6
).map(lambda fields: Topic(**{"topic": "/a", "direction": "transmit", **dict(fields)}))
"""With a few fields set, each to a value of its kind that may break a rule."""
IP = Session(name="robot1", role="client", server_ip="10.0.0.1", server_port=50_000, key_file="robot1.key")
LINKS = {
    "ip": IP,
    "both": msgspec.structs.replace(IP, bluetooth_address="00:11:22:33:44:55"),
    "bluetooth": msgspec.structs.replace(IP, server_ip="00:11:22:33:44:55", server_port=5),
}


def test_every_key_of_a_topic_is_tried() -> None:
    assert set(FIELDS) == set(Topic.__struct_fields__) - {"features"}


@example(topic=Topic("/scan", "transmit", excepts=("/a", f"/{KEY}")), link="ip", use_name=False)
@example(topic=Topic("/vel", "transmit", type=KEY, limits=VelocityLimits(0.5)), link="ip", use_name=True)
@example(topic=Topic("/add", "transmit", kind="service", qos={"depth": 0}, stale_after=-1.0), link="ip", use_name=False)
@example(topic=Topic("/add", "transmit", kind="service", qos=KEY), link="ip", use_name=False)
@given(topic=topics, link=st.sampled_from(list(LINKS)), use_name=st.booleans())
def test_the_rules_say_what_reading_a_file_says(topic: Topic, link: str, use_name: bool) -> None:
    session = msgspec.structs.replace(LINKS[link], use_name=use_name)
    assert validate(session) == [], "what follows is about the topic"
    in_file = validate(msgspec.structs.replace(session, topics=(topic,)))
    # A topic that has the link's own port is no mistake of the topic by itself.
    in_file = [each for each in in_file if topic.port != session.server_port or not each.location.endswith("port")]
    found = entry_problems(topic, session, client="robot1" if use_name else None)
    found = [each for each in found if topic.port != session.server_port or each.location != "port"]
    assert said(found, "") == said(in_file, f"{LISTS[topic.kind]}[0].")


def said(problems: list[Problem], where: str) -> list[tuple[str, str]]:
    """Return the places of problems in the entry, with their texts."""
    return sorted((each.location.removeprefix(where), each.message) for each in problems)


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"topic": f"/{KEY}"}, "topic"),
        ({"topic": f"/{KEY}", "kind": "parameters"}, "node"),
        ({"remote_topic": f"/robot1/{KEY}"}, "remote_topic"),
        ({"type": KEY}, "type"),
        ({"qos": KEY}, "qos"),
        ({"on_end": KEY, "arm": True}, "on_end"),
        ({"beat": KEY}, "beat"),
        ({"topic": "/**", "excepts": ("/a", f"/{KEY}")}, "except[1]"),
    ],
)
def test_key_instead_of_text_is_named_unquoted(change: dict[str, Any], place: str) -> None:
    (problem,) = entry_problems(Topic(**{"topic": "/scan", "direction": "transmit", **change}))
    assert problem.location == place
    assert problem.message == ValueMistake.IS_A_KEY()
