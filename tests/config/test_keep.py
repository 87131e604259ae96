"""A topic's `keep`: read, checked, shown with what it amounts to, and written."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.config.mistakes import problems
from tests.console.scripted import NOW
from tests.model.link_budget_helpers import snapshot
from tests.support.wording import says

from rsb_bridge.config.advice import Advice, advise
from rsb_bridge.config.session_file import load_file, save
from rsb_bridge.config.topic_rules import TopicMistake, entry_problems, transport_of
from rsb_bridge.installed_features import feature_names
from rsb_bridge.model.keep import KEEP_BUDGET, Keep
from rsb_bridge.model.link_budget import CostText, as_report, cost_of, describe_cost
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.topic_keys import ForeignKey
from rsb_console.command.check import SessionCheckText, summary
from rsb_console.session.draft import problems_of, topic_of, values_of

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_bridge.model.wording import Wording

FILE = """\
name: r
role: client
server_ip: 10.0.0.1
server_port: 5
use_encryption: false
topics:
  - {topic: /alarms, direction: transmit, keep: 60}
  - {topic: /odom, direction: transmit, keep: {seconds: 30, megabytes: 8}}
  - {topic: "/log/**", direction: transmit, keep: {seconds: 10}}
"""
SESSION = Session(name="r", role="client", server_ip="10.0.0.1", server_port=5, use_encryption=False)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    made = tmp_path / "robot.yaml"
    made.write_text(FILE)
    return made


def test_what_is_saved_is_what_is_read(path: Path) -> None:
    opened = load_file(path)
    assert [each.kept for each in opened.session.topics] == [Keep(60), Keep(30, 8), Keep(10)]
    first, *others = opened.session.topics
    new = msgspec.structs.replace(opened.session, topics=(msgspec.structs.replace(first, keep=Keep(5, 0.5)), *others))
    save(new, path, opened)
    assert load_file(path).session == new


def test_both_forms_are_one_value() -> None:
    assert Topic("/a", "transmit", keep=Keep(60.0)) == Topic("/a", "transmit", keep=60.0)


@pytest.mark.parametrize(
    ("entry", "key"),
    [
        ("keep: 0", "keep"),
        ("keep: 0.5", "keep"),
        ("keep: 100000", "keep"),
        ("keep: -1", "keep"),
        ("keep: .nan", "keep"),
        ("keep: soon", "keep"),
        ("keep: true", "keep"),
        ("keep: [60]", "keep"),
        ("keep: {}", "keep.seconds"),
        ("keep: {megabytes: 8}", "keep.seconds"),
        ("keep: {seconds: 60, megabytes: 0}", "keep.megabytes"),
        ("keep: {seconds: 60, size: 8}", "keep.size"),
    ],
)
def test_mistakes_are_located(entry: str, key: str) -> None:
    found = problems(FILE.replace("keep: 60", entry))
    assert {(each.location, each.line) for each in found} == {(f"topics[0].{key}", 7)}


@pytest.mark.parametrize(
    ("keys", "mistake"),
    [
        ({"arm": True}, TopicMistake.KEEP_OF_ARMED),
        ({"max_age": 5.0}, TopicMistake.KEEP_BEYOND_AGE),
        ({"qos": {"lifespan": 5.0}}, TopicMistake.KEEP_BEYOND_AGE),
        ({"qos": "sensor_data", "protocol": "udp"}, TopicMistake.KEEP_OF_DATAGRAMS),
        ({"kind": "service"}, ForeignKey.KEEP_OF_CALLED),
        ({"kind": "action"}, ForeignKey.KEEP_OF_CALLED),
    ],
)
def test_what_cannot_be_kept_is_refused(keys: dict[str, Any], mistake: Wording) -> None:
    (problem,) = entry_problems(Topic(**{"topic": "/a", "direction": "transmit", "keep": 60.0, **keys}))
    assert problem.location == "keep"
    assert says(problem.message, mistake)


@pytest.mark.parametrize(
    "keys",
    [
        {"max_age": 60.0},
        {"max_age": 0.0},
        {"qos": {"lifespan": 60.0}},
        {"qos": "sensor_data"},
        {"protocol": "udp"},
        {"topic": "/a/**"},
    ],
)
def test_other_keys_go_with_it(keys: dict[str, Any]) -> None:
    assert entry_problems(Topic(**{"topic": "/a", "direction": "transmit", "keep": 60.0, **keys})) == []


@pytest.mark.skipif("zenoh" not in feature_names(), reason="the core alone")
def test_best_effort_that_is_kept_takes_the_reliable_way() -> None:
    zenoh = msgspec.structs.replace(SESSION, server_ip="zenoh")
    plain = Topic("/a", "transmit", qos="sensor_data")
    kept = msgspec.structs.replace(plain, keep=60.0)
    assert [transport_of(each, zenoh).reliable for each in (plain, kept)] == [False, True]


def test_check_warns_of_link_that_is_given_up_first() -> None:
    session = msgspec.structs.replace(SESSION, topics=(Topic("/a", "transmit", keep=61.0),))
    (problem,) = [each for each in advise(session, None) if each.location.startswith("topics")]
    assert problem.location == "topics[0].keep"
    assert says(problem.message, Advice.KEEP, seconds=61, outlive=60)
    longer = msgspec.structs.replace(session, outlive=61.0)
    assert not [each for each in advise(longer, None) if each.location.startswith("topics")]


def test_check_shows_what_is_kept_and_who_shares(path: Path) -> None:
    lines = list(summary(load_file(path).session))
    (alarms,) = [line for line in lines if "transmit /alarms" in line]
    (odom,) = [line for line in lines if "transmit /odom" in line]
    assert SessionCheckText.KEEPS(kept=Keep(60)) in alarms
    assert SessionCheckText.KEEPS(kept=Keep(30, 8)) in odom
    assert "8 MB" in odom
    assert f"  {SessionCheckText.KEPT(names='/alarms and /log/**', size=KEEP_BUDGET >> 20)}" in lines


def test_check_says_that_nothing_is_kept_of_what_a_line_of_armed_demands() -> None:
    session = msgspec.structs.replace(SESSION, topics=(Topic("/a", "transmit", type="Twist", keep=60.0),))
    armed = msgspec.structs.replace(session, armed=("/a",))
    assert SessionCheckText.KEPT_NOTHING() not in "".join(summary(session))
    assert SessionCheckText.KEPT_NOTHING() in "".join(summary(armed))


@pytest.mark.parametrize(
    ("keep", "text"),
    [(Keep(60), CostText.KEPT), (Keep(60, 8), CostText.KEPT_OF_ITS_OWN)],
)
def test_dry_run_tells_what_the_seconds_amount_to(keep: Keep, text: Wording) -> None:
    cost = cost_of(snapshot(), "robot1", Topic("/odom", "transmit", keep=keep), rate=50.0, size=700.0)
    last = describe_cost(cost, NOW)[-1]
    assert says(last, text, seconds=60)
    assert "2.1 MB" in last
    assert as_report(cost)["kept_bytes"] == 60 * 50 * 700
    assert (
        as_report(cost_of(snapshot(), "robot1", Topic("/odom", "transmit"), rate=50.0, size=700.0))["kept_bytes"]
        is None
    )


@pytest.mark.parametrize(
    ("text", "keep"), [("60", 60.0), ("0.5e2", 50.0), ("{seconds: 60, megabytes: 8}", Keep(60, 8)), ("{seconds: 9}", 9)]
)
def test_a_form_takes_it(text: str, keep: Any) -> None:
    topic = topic_of({"topic": "/odom", "direction": "transmit", "keep": text})
    assert topic.keep == keep
    assert topic_of(values_of(topic)) == topic
    assert problems_of(topic, SESSION, None) == {}


@pytest.mark.parametrize(
    "text", ["0", "soon", "{seconds: long}", "{megabytes: 8}", "{seconds: 60, size: 8}", "{", "{}"]
)
def test_a_form_names_mistakes(text: str) -> None:
    topic = topic_of({"topic": "/odom", "direction": "transmit", "keep": text})
    assert problems_of(topic, SESSION, None).keys() == {"keep"}
