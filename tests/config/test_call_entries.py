"""Services, actions and parameters in a session file: read, checked, and saved in lists of their own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from tests.config.call_entries_helpers import called
from tests.config.mistakes import BLUETOOTH, CLIENT, FILE, SERVER, has, problems
from tests.support.wording import says

from rsb_bridge.config.decoding import Hint, ValueMistake
from rsb_bridge.config.file_form import KEYS, as_topic, as_written
from rsb_bridge.config.name_rules import NameMistake
from rsb_bridge.config.overlaps import OverlapMistake
from rsb_bridge.config.session_changes import changes, described
from rsb_bridge.config.session_file import dump, load, load_file, parse, same, save, validate
from rsb_bridge.config.topic_rules import TopicMistake
from rsb_bridge.config.validation import SessionMistake, validate_topic
from rsb_bridge.model.limits import TOPIC_LENGTH
from rsb_bridge.model.session import Client, Session, Topic
from rsb_bridge.model.topic_keys import CALL_TIME, ForeignKey, RangeText
from rsb_console.session.draft import problems_of
from rsb_console.session.saving import unsaved

if TYPE_CHECKING:
    from rsb_bridge.model.wording import Wording

DOCS = Path(__file__).parents[2] / "docs"
DOCK = "services:\n  - {service: /d, provider: client}\n"
EVERY_KIND = """\
topics:
  - {topic: /scan, direction: transmit}
# what the control room calls
services:
  - {service: /map_server/load_map, provider: client, timeout: 5.0}   # slow
  - service: /dock
    provider: server   # its own
    type: std_srvs/srv/Trigger
actions:
  - {action: /navigate_to_pose, provider: client, arm: true, deadman: 30}
parameters:
  - {node: /controller_server, provider: client, remote_node: /robot/controller}
"""


def service(fields: str, base: str = CLIENT) -> str:
    return f"{base}services:\n  - {{service: /dock, provider: server, {fields}}}\n"


def entry(name: str, fields: str) -> str:
    return f"{CLIENT}{name}:\n  - {fields}\n"


def test_session_lists_what_is_called_beside_its_topics() -> None:
    assert parse(CLIENT + EVERY_KIND, FILE).topics == (
        Topic("/scan", "transmit"),
        Topic("/map_server/load_map", "receive", kind="service", timeout=5.0),
        Topic("/dock", "transmit", type="std_srvs/srv/Trigger", kind="service"),
        Topic("/navigate_to_pose", "receive", kind="action", arm=True, deadman=30.0),
        Topic("/controller_server", "receive", kind="parameters", remote_topic="/robot/controller"),
    )


def test_what_the_documents_show_is_right() -> None:
    shown = [
        block.partition("```")[0]
        for name in ("calls", "services", "sessions")
        for block in (DOCS / f"{name}.md").read_text().split("```yaml\n")[1:]
    ]
    sessions = [parse((SERVER if block.startswith("clients") else CLIENT) + block, FILE) for block in shown]
    kinds = {topic.kind for session in sessions for topic in session.topics}
    assert kinds == {"topic", "service", "action", "parameters"}
    assert any(session.clients for session in sessions)


def test_a_server_lists_it_under_its_clients() -> None:
    listed = EVERY_KIND.replace("\n", "\n    ").rstrip(" ")
    (client,) = parse(f"{SERVER}clients:\n  - name: robot1\n    {listed}", FILE).listed_clients
    assert client.topics == parse(CLIENT + EVERY_KIND, FILE).topics


def test_saved_lists_are_read_again_by_kind() -> None:
    session = parse(CLIENT + EVERY_KIND, FILE)
    mixed = replace(session, topics=session.topics[::-1])
    for each in (session, mixed):
        text = dump(each)
        assert [line for line in text.splitlines() if line.endswith(":")] == [
            "topics:", "services:", "actions:", "parameters:"
        ]  # fmt: skip
        assert same(parse(text, FILE), session)
        assert not validate(each)
    server = Session(
        name="pc", role="server", server_ip="::", server_port=7060, key_file="k",
        clients=(Client("robot1", topics=session.topics), Client("robot2")),
    )  # fmt: skip
    assert parse(dump(server), FILE) == server


@pytest.mark.parametrize(
    ("fields", "code", "parameters"),
    [
        ("kind: service", ForeignKey.KIND_OF_CALLED, {}),
        ("qos: 5", ForeignKey.QOS_OF_CALLED, {}),
        ("expected_rate: 5", ForeignKey.EXPECTED_RATE_OF_CALLED, {}),
        ("stale_after: 5", ForeignKey.STALE_AFTER_OF_CALLED, {}),
        ("direction: transmit", ForeignKey.DIRECTION_OF_CALLED, {}),
        ("remote_topic: /d", ForeignKey.OTHER_REMOTE, {"key": "remote_service"}),
        ("time_out: 1", ValueMistake.MISSPELT_KEY, {"hint": Hint.DID_YOU_MEAN(name="timeout")}),
        ("timeout: 0", TopicMistake.OUT_OF_RANGE, {"value": 0.0, "range": RangeText.TIMEOUT(range=CALL_TIME)}),
        ("timeout: 90000", TopicMistake.OUT_OF_RANGE, {"value": 90000.0}),
        ("timeout: nan", ValueMistake.MISFIT, {"value": "'nan'", "expected": "a number"}),
        ("protocol: udp", TopicMistake.CALL_NEEDS_RELIABLE, {"protocol": "udp"}),
        ("protocol: bluetooth", TopicMistake.NEEDS_ADAPTER, {}),
        ("port: 0", TopicMistake.INVALID_PORT, {"port": 0, "kind": "port"}),
        ("max_rate: 0", TopicMistake.OUT_OF_RANGE, {"value": 0.0}),
        ("deadman: 5", TopicMistake.DEADMAN_WITHOUT_ARM, {"kind": "a service"}),
        ("type: std_srvs/Trigger", TopicMistake.NOT_A_TYPE, {"hint": Hint.DID_YOU_MEAN(name="std_srvs/srv/Trigger")}),
        ("type: std_srvs/msg/Trigger", TopicMistake.NOT_A_TYPE, {"folder": "srv"}),
        ("type: Trigger", TopicMistake.NOT_A_TYPE, {"name": "'Trigger'", "kind": "a service", "folder": "srv"}),
        (f"type: a/srv/{'B' * 300}", TopicMistake.CALLED_TYPE_TOO_LONG, {}),
        ("remote_service: dock", NameMistake.NOT_ABSOLUTE, {"name": "'dock'", "noun": "service"}),
        ("remote_service: /_rsb_bridge/x", NameMistake.OF_THE_BRIDGE, {"name": "'/_rsb_bridge/x'"}),
        ("remote_service: /a/_action/send_goal", NameMistake.PART_OF_ACTION, {"action": "/a"}),
        ("type: p/action/A", TopicMistake.TYPE_OF_OTHER_KIND, {"kind": "an action"}),
    ],
)
def test_mistake_of_service_has_its_line_and_key(fields: str, code: Wording, parameters: dict[str, Any]) -> None:
    (problem,) = problems(service(fields))
    assert has(problem, 7, f"services[0].{fields.partition(':')[0]}", code, parameters)


@pytest.mark.parametrize(
    ("kind", "fields", "key", "code", "parameters"),
    [
        ("services", "{service: /d}", "provider", ValueMistake.MISSING, {}),
        ("services", "{service: /d, provider: robot}", "provider", ValueMistake.MISFIT, {"value": "'robot'"}),
        ("services", "{provider: client}", "service", ValueMistake.MISSING, {"expected": "text"}),
        ("services", "{service: /a/_action/get_result, provider: client}", "service", NameMistake.PART_OF_ACTION, {}),
        ("services", "{service: /_rsb_bridge/published, provider: client}", "service", NameMistake.OF_THE_BRIDGE, {}),
        ("services", "{topic: /d, provider: client, service: /d}", "topic", ForeignKey.LIST_UNDER, {"list": "topics"}),
        ("actions", "{action: /a, provider: client, type: p/srv/A}", "type", TopicMistake.TYPE_OF_OTHER_KIND, {}),
        (
            "actions",
            f"{{action: /a, provider: client, type: p/action/{'A' * 231}}}",  # of 240: _FeedbackMessage makes it 256
            "type",
            TopicMistake.CALLED_TYPE_TOO_LONG,
            {"length": 240},
        ),
        ("services", "{service: /d/**x, provider: client}", "service", NameMistake.NOT_A_PATTERN, {}),
        ("parameters", "{node: n, provider: client}", "node", NameMistake.NOT_ABSOLUTE, {}),
        ("parameters", "{node: /n, provider: client, type: x}", "type", ForeignKey.TYPE_OF_PARAMETERS, {}),
        ("topics", "{topic: /a, direction: transmit, kind: service}", "kind", ForeignKey.KIND_OF_TOPIC, {}),
        ("topics", "{topic: /a, direction: transmit, timeout: 3}", "timeout", ForeignKey.TIMEOUT_OF_TOPIC, {}),
        ("topics", "{topic: /a, direction: transmit, provider: client}", "provider", ForeignKey.PROVIDER_OF_TOPIC, {}),
        ("topics", "{topic: /a, direction: transmit, node: /n}", "node", ForeignKey.NOT_A_TOPIC, {}),
    ],
)
def test_mistake_of_entry_has_its_line_and_key(
    kind: str, fields: str, key: str, code: Wording, parameters: dict[str, Any]
) -> None:
    (problem,) = problems(entry(kind, fields))
    assert has(problem, 7, f"{kind}[0].{key}", code, parameters)


@pytest.mark.parametrize(
    ("text", "place", "code", "parameters"),
    [
        (service("protocol: udp", BLUETOOTH), "7 services[0].protocol", TopicMistake.CALL_NEEDS_RELIABLE, {}),
        (service("protocol: tcp", BLUETOOTH), "7 services[0].protocol", TopicMistake.NOT_CROSSING,
         {"protocol": "tcp", "crossing": "bluetooth"}),
        (entry("services", "/d"), "7 services[0]", ValueMistake.NOT_A_MAPPING, {}),
        (CLIENT + "services: /d\n", "6 services", ValueMistake.NOT_A_LIST, {"value": "'/d'"}),
        (CLIENT + "service: []\n", "6 service", ValueMistake.MISSPELT_KEY, {}),
        (SERVER + "services:\n  - {service: /d, provider: client}\n", "2 role", SessionMistake.TOPICS_OF_SERVER, {}),
        (SERVER + "clients:\n  - name: a\n    services:\n      - {service: /d, provider: client, timeout: -1}\n",
         "9 clients[0].services[0].timeout", TopicMistake.OUT_OF_RANGE, {"value": -1.0}),
        (f"{CLIENT}{DOCK}  - {{service: /d, provider: client}}\n", "8 services[1]", SessionMistake.TOPIC_TWICE,
         {"name": "/d", "number": 1}),
        (f"{CLIENT}{DOCK}  - {{service: /d, provider: server}}\n", "8 services[1]",
         OverlapMistake.OTHER_PROVIDER, {"provider": "client"}),
        (CLIENT + "services: [{service: /n/set_parameters, provider: client}]\n"
         "parameters: [{node: /n, provider: client}]\n", "7 parameters[0]", OverlapMistake.BRIDGED_ALREADY,
         {"service": "/n/set_parameters", "noun": "service", "name": "/n/set_parameters"}),
    ],
)  # fmt: skip
def test_a_mistake_has_its_line_and_place(text: str, place: str, code: Wording, parameters: dict[str, Any]) -> None:
    (problem,) = problems(text)
    assert f"{problem.line} {problem.location}" == place
    assert says(problem.message, code, **parameters)


def test_topic_service_and_action_may_have_one_name() -> None:
    lists = "topics: [{topic: /d, direction: transmit}]\nservices: [{service: /d, provider: client}]\n"
    lists += "actions: [{action: /d, provider: client}]\nparameters: [{node: /d, provider: client}]\n"
    assert len({topic.identity for topic in parse(CLIENT + lists, FILE).topics}) == 4


def test_names_leave_room_for_what_belongs_to_them() -> None:
    longest = f"/{'n' * (TOPIC_LENGTH - len('/_action/cancel_goal') - 1)}"
    assert validate_topic(Topic(longest, "transmit", kind="action")) == []
    for topic, client in ((Topic(f"{longest}n", "transmit", kind="action"), None),
                          (Topic(longest, "transmit", kind="action"), "robot1")):  # fmt: skip
        assert [problem.location for problem in validate_topic(topic, client=client)] == ["action"]


@pytest.mark.parametrize(
    ("field", "value"), [("qos", 5), ("expected_rate", 1.0), ("stale_after", 3.0)]
)  # fmt: skip
def test_session_refuses_what_file_cannot_say(field: str, value: Any) -> None:
    """By a peer's proposal, or a program at the control socket."""
    topic = Topic("/d", "transmit", kind="service", **{field: value})
    assert [problem.location for problem in validate_topic(topic)] == [field]
    session = replace(parse(CLIENT, FILE), topics=(Topic("/a", "transmit"), topic))
    assert [problem.location for problem in validate(session)] == [f"services[0].{field}"]
    timed = replace(session, topics=(Topic("/a", "transmit", timeout=3.0),))
    assert [problem.location for problem in validate(timed)] == ["topics[0].timeout"]


@pytest.mark.parametrize(
    ("change", "before", "after"),
    [
        (
            lambda topics: (topics[0], replace(topics[1], timeout=9.0), *topics[2:]),
            "timeout: 5.0}   # slow",
            "timeout: 9}   # slow",
        ),
        (lambda topics: (Topic("/b", "receive", kind="service"), *topics), "    type: std_srvs/srv/Trigger\n",
         "    type: std_srvs/srv/Trigger\n  - service: /b\n    provider: client\n"),
    ],
    ids=["edited", "added first"],
)  # fmt: skip
def test_a_save_changes_only_what_changed(change: Any, before: str, after: str, tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(CLIENT + EVERY_KIND)
    opened = load_file(path)
    session = replace(opened.session, topics=change(opened.session.topics))
    save(session, path, opened)
    assert path.read_text() == (CLIENT + EVERY_KIND).replace(before, after)
    assert same(load(path), session)


def test_first_service_of_file_begins_list(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(f"{CLIENT}topics:\n  - {{topic: /scan, direction: transmit}}  # laser\n# the end\n")
    opened = load_file(path)
    save(replace(opened.session, topics=(*opened.session.topics, Topic("/d", "receive", kind="service"))), path, opened)
    assert path.read_text().endswith(
        "  - {topic: /scan, direction: transmit}  # laser\nservices:\n  - {service: /d, provider: client}\n# the end\n"
    )


calls = st.builds(
    Topic,
    topic=st.sampled_from(["/a", "/b", "/c/d"]), direction=st.sampled_from(["transmit", "receive"]),
    kind=st.sampled_from(["topic", "service", "action", "parameters"]), protocol=st.sampled_from([None, "tcp"]),
    remote_topic=st.sampled_from([None, "/e"]), max_rate=st.none() | st.floats(0.5, 99), paused=st.booleans(),
    arm=st.booleans(),
)  # fmt: skip
several = st.lists(calls, max_size=6, unique_by=(lambda topic: (topic.kind, topic.topic), called)).map(tuple)


@given(old=several, new=several)
def test_a_save_of_any_kinds_is_a_merge(old: tuple[Topic, ...], new: tuple[Topic, ...]) -> None:
    from rsb_bridge.config.merge import merge
    from rsb_bridge.config.yaml_text import read_yaml

    session = replace(parse(CLIENT, FILE), topics=old)
    text = f"# first\n{dump(session)}# last\n"
    now = replace(session, topics=new)
    result = merge(text, read_yaml(text, FILE).root, parse(text, FILE), now)
    assert same(parse(result, FILE), now)
    assert result.startswith("# first\n")
    assert "# last\n" in result
    if same(session, now):
        assert result == text


@given(topic=calls)
def test_an_entry_says_all_of_a_topic(topic: Topic) -> None:
    written = as_written(topic)
    assert as_topic(topic.kind, written) == topic
    assert set(written.__struct_fields__) == set(KEYS[topic.kind])


def test_differences_are_told_in_words_of_file() -> None:
    old = Topic("/dock", "transmit", kind="service")
    new = replace(old, remote_topic="/robot/dock", timeout=5.0)
    assert changes(old, new) == ["remote_service none → /robot/dock", "timeout none → 5.0"]
    assert described(new) == "{service: /dock, provider: server, remote_service: /robot/dock, timeout: 5.0}"
    session = parse(CLIENT, FILE)
    assert unsaved(session, replace(session, topics=(Topic("/dock", "transmit"), new))) == "added /dock, /dock"


def test_form_names_mistakes_by_topics_fields() -> None:
    session = parse(CLIENT + EVERY_KIND, FILE)
    new = Topic("dock", "transmit", remote_topic="x", kind="service", timeout=0.0)
    assert set(problems_of(new, session, None)) == {"topic", "remote_topic", "timeout"}
    assert set(problems_of(Topic("/dock", "transmit", kind="service"), session, None)) == {"topic"}
    part = Topic("/controller_server/get_parameters", "receive", kind="service")
    assert set(problems_of(part, session, None)) == {"topic"}
    assert problems_of(Topic("/undock", "transmit", kind="service"), session, None) == {}
