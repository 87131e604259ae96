"""A topic whose values are of the right kinds is judged as the same entry of a file: no more and no less is refused."""

from __future__ import annotations

import math
from typing import Any, get_args

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rsb_bridge.config.decoding import ValueMistake
from rsb_bridge.config.file_form import LISTS
from rsb_bridge.config.keys import generate
from rsb_bridge.config.topic_rules import entry_problems
from rsb_bridge.config.validation import validate
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.keep import Keep
from rsb_bridge.model.session import RANKS, Direction, Problem, Session, Topic
from rsb_bridge.model.topic_keys import TOPIC_KEYS
from rsb_bridge.model.transports import Protocol

KEY = generate().decode()
PARTS = ("a", "scan", "_hidden", "_action", "*", "**", "a*", "1a", "", "rsb", "ä", "a b", "\0", "\n", "a" * 250, KEY)
TYPES = ("auto", "LaserScan", "Twist", "a/msg/B", "a/srv/B", "a/action/B", "a/B", "", "a/../B", KEY, f"a/{KEY}")
QOS: tuple[Any, ...] = (
    "auto", "latched", "lached", 5, -1, 10**9, KEY, {}, {"depth": 0}, {"depth": "5"}, {"profile": "latched"},
    {"profile": "lached"}, {"profile": []}, {"reliability": "reliable"}, {"reliability": KEY}, {"rate": 5},
    {"deadline": 1e-9}, {"deadline": None, "lifespan": math.inf}, {"depth": True},
)  # fmt: skip
ENDS = ("zero", "none", "cancel", "stop", "{linear: {x: 0.1}}", '{"linear": {"x": 0.1}}', "{", "{}", KEY, "{" * 5000)

paths = st.lists(st.sampled_from(PARTS), min_size=1, max_size=4).map(lambda parts: "/" + "/".join(parts))
names = st.sampled_from(["/scan", "/a/b", "/camera/**"]) | paths | st.text(max_size=8)
numbers = st.none() | st.sampled_from([0.0, 1.0, 5.0, -1.0, 1e-9, 1e12, math.inf, math.nan])
FIELDS: dict[str, st.SearchStrategy[Any]] = {
    **{name: st.booleans() for name, key in TOPIC_KEYS.items() if key.value == "switch"},
    **{name: st.none() | st.booleans() for name, key in TOPIC_KEYS.items() if key.value == "choice"},
    **{name: numbers for name, key in TOPIC_KEYS.items() if key.value == "number"},
    "topic": names,
    "direction": st.sampled_from(get_args(Direction)),
    "type": st.sampled_from(TYPES) | st.text(max_size=8),
    "protocol": st.none() | st.sampled_from(get_args(Protocol)),
    "port": st.none() | st.integers(-1, 70_000) | st.sampled_from([1, 30]),
    "qos": st.sampled_from(QOS),
    "remote_topic": st.none() | names,
    "compression": st.none() | st.sampled_from(["none", "zstd"]),
    "on_end": st.none() | st.sampled_from(ENDS) | st.text(max_size=8),
    "limits": st.none() | st.builds(VelocityLimits, numbers, numbers),
    "beat": st.none() | st.sampled_from(["front", "", KEY, "a\nb", "a" * 300]),
    "keep": numbers | st.builds(Keep, numbers.filter(lambda number: number is not None), numbers),
    "kind": st.sampled_from(list(LISTS)),
    "priority": st.sampled_from(list(RANKS)),
    "excepts": st.lists(names, max_size=3).map(tuple) | st.just(("/a",) * 101),
}
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
