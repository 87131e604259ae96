"""Mistakes in session files: each has a location, a line and a code."""

import errno
import os
from pathlib import Path
from typing import Any, get_args

import pytest
from tests.config.mistakes import BLUETOOTH, CLIENT, FILE, SERVER, has, problems
from tests.support.wording import says

from rsb_bridge.config.decoding import Hint, ValueMistake
from rsb_bridge.config.grants import RightsMistake
from rsb_bridge.config.name_rules import NameMistake
from rsb_bridge.config.session_file import SessionError, load, parse, validate, validate_topic
from rsb_bridge.config.topic_rules import TopicMistake
from rsb_bridge.config.validation import SessionMistake
from rsb_bridge.config.yaml_text import FileProblem, YamlMistake
from rsb_bridge.model.limits import CHANNEL, DEPTH, DOMAIN, OUTLIVE, PACE, PORT, RATE
from rsb_bridge.model.names import ANNOUNCEMENT_TOPIC
from rsb_bridge.model.qos import QosProblem
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.topic_keys import RangeText
from rsb_bridge.model.transports import Protocol
from rsb_bridge.model.type_names import TypeNameProblem
from rsb_bridge.model.wording import Wording

CLOSE_TO_LASER_SCAN = " or ".join(
    f"sensor_msgs/msg/{name}" for name in ("LaserScan", "MultiEchoLaserScan", "LaserEcho")
)
MAC = "5C:F3:70:9A:1B:2E"


def refusals(text: str) -> list[str]:
    with pytest.raises(SessionError) as caught:
        parse(text, FILE)
    return str(caught.value).splitlines()


def topic(fields: str, base: str = CLIENT) -> str:
    return f"{base}topics:\n  - {{topic: /scan, direction: transmit, {fields}}}\n"


def topics(entry: str) -> str:
    return f"{CLIENT}topics:\n  - {entry}\n"


def clients(entry: str) -> str:
    return f"{SERVER}clients:\n  - {entry}\n"


@pytest.mark.parametrize(
    ("fields", "code", "parameters"),
    [
        ("protocol: tpc", ValueMistake.MISFIT, {}),
        ("protocol: TCP", ValueMistake.MISFIT, {"hint": Hint.DID_YOU_MEAN(name="tcp")}),
        ("protcol: tcp", ValueMistake.MISSPELT_KEY, {"hint": Hint.DID_YOU_MEAN(name="protocol")}),
        ("qos: sensor-data", Hint.DID_YOU_MEAN, {"name": "sensor_data"}),
        ("qos: 0", QosProblem.DEPTH_OUT_OF_RANGE, {"depth": 0, "range": DEPTH}),
        ("qos: {depth: -1}", QosProblem.DEPTH_OUT_OF_RANGE, {"depth": -1}),
        ("qos: {profile: sensor-data}", QosProblem.UNKNOWN_PROFILE, {"value": "sensor-data"}),
        ("qos: {profile: [latched]}", QosProblem.UNKNOWN_PROFILE, {"value": ["latched"]}),
        ("qos: {deadline: 1e400}", QosProblem.TIME_OUT_OF_RANGE, {}),
        ("qos: 99999999999999999999", QosProblem.DEPTH_OUT_OF_RANGE, {"depth": 99999999999999999999}),
        ("qos: [1]", ValueMistake.MISFIT, {"value": "[1]", "expected": "text or a whole number or a mapping"}),
        ("type: LaserScann", TypeNameProblem.SHORT_NAME_MISSPELT, {"names": CLOSE_TO_LASER_SCAN}),
        ("type: sensor_msgs.msg.LaserScan", TypeNameProblem.SHORT_NAME_UNKNOWN, {}),
        ("port: 0", TopicMistake.INVALID_PORT, {"port": 0, "kind": "port", "range": PORT}),
        ("port: 65536", TopicMistake.INVALID_PORT, {"port": 65536, "kind": "port"}),
        ("port: '49153'", ValueMistake.MISFIT, {}),
        ("port: 49152", SessionMistake.PORT_OF_LINK, {"port": 49152}),
        ("protocol: bluetooth", TopicMistake.NEEDS_ADAPTER, {}),
        ("max_rate: 0", TopicMistake.OUT_OF_RANGE, {"value": 0.0}),
        ("max_rate: 1e-310", TopicMistake.OUT_OF_RANGE, {"value": 1e-310, "range": RangeText.RATE(range=RATE)}),
        ("max_rate: 1e7", TopicMistake.OUT_OF_RANGE, {"value": 10000000.0}),
        ("expected_rate: -1", TopicMistake.OUT_OF_RANGE, {}),
        ("expected_rate: 1e-310", TopicMistake.OUT_OF_RANGE, {"value": 1e-310}),
        ("stale_after: -1", TopicMistake.OUT_OF_RANGE, {}),
        ("stale_after: 1e-300", TopicMistake.OUT_OF_RANGE, {}),
        ("paused: yes", ValueMistake.MISFIT, {"value": "'yes'", "expected": "true or false"}),
        ("arm: 1", ValueMistake.MISFIT, {"value": 1, "expected": "true or false"}),
        ("deadman: 30", TopicMistake.DEADMAN_WITHOUT_ARM, {"kind": "a topic"}),
        ("remote_topic: scan", NameMistake.NOT_ABSOLUTE, {"name": "'scan'", "noun": "topic"}),
        ('remote_topic: ""', NameMistake.NO_NAME, {"noun": "topic"}),
        ("remote_topic: ~/scan", NameMistake.NOT_ABSOLUTE, {"hint": Hint.DID_YOU_MEAN(name="/scan")}),
        ("remote_topic: /front-scan/2", NameMistake.NOT_ABSOLUTE, {"hint": Hint.DID_YOU_MEAN(name="/front_scan/_2")}),
        ("topic: /other", YamlMistake.DUPLICATE_KEY, {"line": 7}),
    ],
)
def test_mistake_of_topic_has_its_line_and_key(fields: str, code: Wording, parameters: dict[str, Any]) -> None:
    (problem,) = problems(topic(fields))
    assert has(problem, 7, f"topics[0].{fields.partition(':')[0]}", code, parameters)


@pytest.mark.parametrize(
    ("text", "place", "code", "parameters"),
    [
        (topic("qos: {reliability: reliabel}"), "7 topics[0].qos.reliability", ValueMistake.MISFIT, {}),
        (topic("qos: {realiability: reliable}"), "7 topics[0].qos.realiability", ValueMistake.MISSPELT_KEY, {}),
        (topic("port: 31", BLUETOOTH), "7 topics[0].port", TopicMistake.INVALID_PORT, {}),
        (topic("protocol: udp", BLUETOOTH), "7 topics[0].protocol", TopicMistake.NOT_CROSSING,
         {"crossing": "bluetooth"}),
        (topic("protocol: bluetooth", f"{CLIENT}bluetooth_address: {MAC}\n"), "8 topics[0].port",
         TopicMistake.NEEDS_CHANNEL, {"range": CHANNEL}),
        (topic("protocol: bluetooth, port: 31", f"{CLIENT}bluetooth_address: {MAC}\n"), "8 topics[0].port",
         TopicMistake.INVALID_PORT, {"port": 31}),
        (f"{CLIENT}bluetooth_address: 10.0.0.1\n", "6 bluetooth_address", SessionMistake.ADAPTER_INVALID, {}),
        (f"{BLUETOOTH}bluetooth_address: {MAC}\n", "6 bluetooth_address", SessionMistake.ADAPTER_TWICE, {}),
        (CLIENT + "stale_after: 1e300\n", "6 stale_after", TopicMistake.OUT_OF_RANGE, {"value": 1e300}),
        (topic("arm: true, deadman: 1"), "7 topics[0].deadman", TopicMistake.OUT_OF_RANGE, {}),
        (topic(f"remote_topic: {ANNOUNCEMENT_TOPIC}"), "7 topics[0].remote_topic", NameMistake.ANNOUNCEMENT, {}),
        (topics('{topic: "", direction: transmit}'), "7 topics[0].topic", NameMistake.NO_NAME, {}),
        (topics("{topic: scan, direction: transmit}"), "7 topics[0].topic", NameMistake.NOT_ABSOLUTE, {}),
        (topics("topic: /scan"), "7 topics[0].direction", ValueMistake.MISSING, {}),
        (topics("/scan"), "7 topics[0]", ValueMistake.NOT_A_MAPPING, {"value": "'/scan'", "keys": "topic, direction",
         "hint": Hint.ENTRY(entry="{topic: /scan, direction: ...}")}),
        (CLIENT + "topics[2]server_ip: x\n", "6 topics[2]server_ip", ValueMistake.MISSPELT_KEY, {}),
        (CLIENT + "topics: /scan\n", "6 topics", ValueMistake.NOT_A_LIST, {"value": "'/scan'",
         "hint": Hint.ENTRY(entry="{topic: /scan, direction: ...}")}),
        (CLIENT + "topics:\n  /scan:\n    direction: transmit\n", "6 topics", ValueMistake.NOT_A_LIST,
         {"hint": Hint.ENTRY(entry="{topic: /scan, direction: ...}")}),
        (CLIENT + "topics: {topic: /scan, direction: transmit}\n", "6 topics", ValueMistake.NOT_A_LIST,
         {"hint": Hint.ENTRY(entry="{topic: ..., direction: ...}")}),
        (SERVER + "clients: robot1\n", "6 clients", ValueMistake.NOT_A_LIST,
         {"hint": Hint.ENTRY(entry="{name: robot1}")}),
        (SERVER + "clients: [robot1]\n", "6 clients[0]", ValueMistake.NOT_A_MAPPING,
         {"hint": Hint.ENTRY(entry="{name: robot1}")}),
        (CLIENT + "topics:\n", "6 topics", ValueMistake.NO_VALUE, {}),
        (CLIENT + "name: other\n", "6 name", YamlMistake.DUPLICATE_KEY, {"line": 1}),
        (CLIENT + "domain_id: 233\n", "6 domain_id", SessionMistake.DOMAIN_INVALID, {"domain": 233, "range": DOMAIN}),
        (CLIENT + "stale_after: .inf\n", "6 stale_after", ValueMistake.MISFIT, {}),
        (CLIENT + "ports: none\n", "6 ports", SessionMistake.KEY_OF_SERVER, {}),
        (SERVER + "ports: [12001, 80]\n", "6 ports[1]", SessionMistake.TOPIC_PORT_INVALID, {}),
        (SERVER + "ports: [12001, x]\n", "6 ports[1]", ValueMistake.MISFIT, {"value": "'x'"}),
        (SERVER + "ports: nine\n", "6 ports", ValueMistake.MISFIT, {"value": "'nine'"}),
        (CLIENT + "stale_warnings: -1\n", "6 stale_warnings", SessionMistake.STALE_WARNINGS_NEGATIVE, {"count": -1}),
        (CLIENT + "outlive: -1\n", "6 outlive", SessionMistake.OUT_OF_RANGE, {"value": -1.0, "range": OUTLIVE}),
        (CLIENT + "pace: 0.03\n", "6 pace", SessionMistake.OUT_OF_RANGE, {"value": 0.03, "range": PACE}),
        (BLUETOOTH + "multipath: true\n", "6 multipath", SessionMistake.MULTIPATH_UNKNOWN, {"medium": "Bluetooth"}),
        (CLIENT + "outlive: 86401\n", "6 outlive", SessionMistake.OUT_OF_RANGE, {"range": OUTLIVE}),
        (CLIENT + "shutdown_topic: shutdown\n", "6 shutdown_topic", NameMistake.NOT_ABSOLUTE, {}),
        (CLIENT + "clients: [{name: robot2}]\n", "2 role", SessionMistake.CLIENTS_OF_CLIENT, {}),
        (CLIENT + "encryption_key: abc\n", "6 encryption_key", ValueMistake.SECRET_KEY, {}),
        (CLIENT.replace("robot1", "robot-1") + "use_name: true\n", "1 name", SessionMistake.NAME_NOT_A_PREFIX, {}),
        (CLIENT.replace("robot1", "12"), "1 name", ValueMistake.MISFIT, {}),
        (CLIENT.replace("robot1", "' '"), "1 name", SessionMistake.NAME_UNPRINTABLE, {}),
        (CLIENT.replace("robot1", "r" * 256), "1 name", SessionMistake.NAME_TOO_LONG, {"length": 256, "limit": 255}),
        (CLIENT.replace("192.168.1.10", "192.168.1"), "3 server_ip", SessionMistake.ADDRESS_INVALID, {}),
        (CLIENT.replace("192.168.1.10", "192.168.1.256"), "3 server_ip", SessionMistake.ADDRESS_INVALID, {}),
        (CLIENT.replace("192.168.1.10", "0.0.0.0"), "3 server_ip", SessionMistake.ADDRESS_OF_CLIENT, {}),
        (CLIENT.replace("192.168.1.10", "[10.0.0.1, fe80::1]"), "3 server_ip[1]", SessionMistake.ZONE_MISSING, {}),
        (CLIENT.replace("192.168.1.10", "[10.0.0.1, 10.0.0.1]"), "3 server_ip[1]", SessionMistake.ADDRESS_TWICE, {}),
        (CLIENT.replace("192.168.1.10", "[10.0.0.1, 5C:F3:70:9A:1B:2E]"), "3 server_ip",
         SessionMistake.ADDRESSES_OF_SEVERAL_KINDS, {}),
        (CLIENT.replace("192.168.1.10", "[10.0.0.1, 5]"), "3 server_ip[1]", ValueMistake.MISFIT, {"value": "5"}),
        (CLIENT.replace("192.168.1.10", "[]"), "3 server_ip", SessionMistake.ADDRESS_EMPTY, {}),
        (SERVER.replace("0.0.0.0", "[10.0.0.1, 10.0.0.2]"), "3 server_ip", SessionMistake.ADDRESSES_OF_SERVER, {}),
        (CLIENT.replace("192.168.1.10", "fe80::1"), "3 server_ip", SessionMistake.ZONE_MISSING, {"address": "fe80::1"}),
        (CLIENT.replace("192.168.1.10", "5C-F3-70-9A-1B-2E"), "3 server_ip", SessionMistake.ADDRESS_WITH_DASHES, {}),
        (BLUETOOTH.replace("port: 5", "port: 31"), "4 server_port", TopicMistake.INVALID_PORT, {}),
        (CLIENT.replace("role: client", "role: cleint"), "2 role", ValueMistake.MISFIT, {}),
        (CLIENT.replace("key_file: key.txt\n", ""), "1 key_file", SessionMistake.KEY_FILE_MISSING, {}),
        (CLIENT.replace("key_file: key.txt", "key_file: ''"), "5 key_file", SessionMistake.KEY_FILE_INVALID, {}),
        (CLIENT.replace("key_file: key.txt", r'key_file: "k\0y"'), "5 key_file", SessionMistake.KEY_FILE_INVALID, {}),
        (clients('{name: a, allow: ["/\\ud800"]}'), "7 clients[0].allow[0]", RightsMistake.NO_MATCH, {}),
        (SERVER + "topics: [{topic: /a, direction: receive}]\n", "2 role", SessionMistake.TOPICS_OF_SERVER, {}),
        (clients("{name: a}\n  - {name: a}"), "8 clients[1].name", SessionMistake.CLIENT_TWICE, {}),
        (SERVER + "clients:\n  - name: a\n    topics:\n      - {topic: /b, direction: transmit, protocol: tpc}\n",
         "9 clients[0].topics[0].protocol", ValueMistake.MISFIT, {"value": "'tpc'"}),
        (SERVER + "clients:\n  - name: a\n    topics:" + 2 * "\n    - {topic: /b, direction: transmit}",
         "10 clients[0].topics[1]", SessionMistake.TOPIC_TWICE, {"name": "/b", "end": "transmit", "number": 1}),
        (clients("{name: a, allow: [scan]}"), "7 clients[0].allow[0]", RightsMistake.NO_MATCH, {}),
        (clients("{name: a, deny: scan}"), "7 clients[0].deny", ValueMistake.NOT_A_LIST, {}),
        (clients("{name: a b, use_name: true}"), "7 clients[0].name", SessionMistake.NAME_NOT_A_PREFIX, {}),
        (SERVER.replace("key_file: key.txt\n", "clients: [{name: a}]\n"), "5 clients[0].key_file",
         SessionMistake.KEY_FILE_MISSING, {}),
        (SERVER + "next_key_file: key.txt\n", "6 next_key_file", SessionMistake.NEXT_KEY_IS_CURRENT, {}),
        (SERVER + "next_key_file: ''\n", "6 next_key_file", SessionMistake.KEY_FILE_INVALID, {"name": "''"}),
        (CLIENT + "next_key_file: new.key\n", "6 next_key_file", SessionMistake.NEXT_KEY_ON_CLIENT, {}),
        (SERVER.replace("key_file: key.txt", "next_key_file: b\nclients: [{name: a, key_file: a.key}]"),
         "5 next_key_file", SessionMistake.NEXT_KEY_ALONE, {}),
        (clients("{name: a, key_file: a.key, next_key_file: a.key}"), "7 clients[0].next_key_file",
         SessionMistake.NEXT_KEY_IS_CURRENT, {"name": "'a.key'"}),
        (clients("{name: a, next_key_file: key.txt}"), "7 clients[0].next_key_file", SessionMistake.NEXT_KEY_IS_CURRENT,
         {"name": "'key.txt'"}),
    ],
)  # fmt: skip
def test_a_mistake_has_its_line_and_place(text: str, place: str, code: Wording, parameters: dict[str, Any]) -> None:
    (problem,) = problems(text)
    assert f"{problem.line} {problem.location}" == place
    assert says(problem.message, code, **parameters)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (topic("protocol: tpc"), f"one of {', '.join(get_args(Protocol))}"),
        (topic("qos: {reliability: reliabel}"), Hint.DID_YOU_MEAN(name="reliable")),
        (topic("port: '49153'"), Hint.NO_QUOTES()),
        (topics("{topic: scan, direction: transmit}"), Hint.DID_YOU_MEAN(name="/scan")),
        (CLIENT.replace("robot1", "12"), Hint.QUOTES()),
        (CLIENT.replace("role: client", "role: cleint"), Hint.DID_YOU_MEAN(name="client")),
        (CLIENT.replace("192.168.1.10", "5C-F3-70-9A-1B-2E"), Hint.DID_YOU_MEAN(name=MAC)),
    ],
)
def test_a_mistake_says_what_can_be_written_instead(text: str, words: str) -> None:
    (problem,) = problems(text)
    assert words in problem.message


@pytest.mark.parametrize(
    ("text", "line", "place"),
    [
        (topic("protocol: tpc"), 7, "topic /scan, protocol"),
        (topic("qos: {reliability: reliabel}"), 7, "topic /scan, qos.reliability"),
        (CLIENT + "topics:\n  - /scan\n", 7, "topic 1"),
        (CLIENT + "topics[2]server_ip: x\n", 6, "topics[2]server_ip"),
        (SERVER + "ports: [12001, 80]\n", 6, "ports[1]"),
        (SERVER + "clients:\n  - {name: a, allow: [scan]}\n", 7, "client a, allow[0]"),
        (SERVER + "clients:\n  - name: a\n    topics:\n      - {topic: /b, direction: transmit, protocol: tpc}\n", 9,
         "client a, topic /b, protocol"),
        (CLIENT + "services:\n  - {service: /d, provider: robot}\n", 7, "service /d, provider"),
        (CLIENT + "services:\n  - /d\n", 7, "service 1"),
        (CLIENT + "parameters:\n  - {node: n, provider: client}\n", 7, "parameters of n, node"),
    ],
)  # fmt: skip
def test_a_mistake_names_its_entry(text: str, line: int, place: str) -> None:
    (refusal,) = refusals(text)
    assert refusal.startswith(f"robot1.yaml:{line}: {place}: ")


def test_all_mistakes_come_at_once_in_order() -> None:
    found = refusals(
        "name: robot1\nrole: clint\nserver_ip: ''\nserver_port: 0\ncolour: red\ntopics:\n"
        "  - {topic: scan, direction: transmit, protocol: tpc, max_rate: 0}\n"
        "  - {topic: /map}\n"
    )
    places = [(line.split(":")[1], line.split(":")[2].strip()) for line in found]
    assert set(places) == {
        ("1", "key_file"),
        ("2", "role"),
        ("3", "server_ip"),
        ("4", "server_port"),
        ("5", "colour"),
        ("7", "topic scan, topic"),
        ("7", "topic scan, protocol"),
        ("7", "topic scan, max_rate"),
        ("8", "topic /map, direction"),
    }
    assert [int(line) for line, _ in places] == sorted(int(line) for line, _ in places)


def test_consequences_of_mistake_are_no_mistakes() -> None:
    """A mistyped direction could be either: it makes no duplicate of the topic's other direction."""
    found = refusals(CLIENT + "topics:\n  - {topic: /a, direction: transmit}\n  - {topic: /a, direction: recieve}\n")
    assert len(found) == 1
    assert "topic /a, direction" in found[0]


def test_repeated_topic_is_refused_both_ways_is_not() -> None:
    both = CLIENT + "topics:\n  - {topic: /a, direction: transmit}\n  - {topic: /a, direction: receive}\n"
    assert len(parse(both, FILE).topics) == 2
    (problem,) = problems(both + "  - {topic: /a, direction: receive, protocol: udp}\n")
    assert (problem.location, problem.line, problem.place) == ("topics[2]", 9, "topic /a")
    assert says(problem.message, SessionMistake.TOPIC_TWICE, name="/a", end="receive", number=2)


@pytest.mark.parametrize("use_name", ["", "use_name: true\n"])
def test_one_topic_of_server_has_one_name(use_name: str) -> None:
    """The bridge refuses such a route, and did not start."""
    of_server = "/robot1/a" if use_name else "/a"
    text = CLIENT + use_name + "topics:\n  - {topic: /a, direction: receive}\n"
    assert len(parse(text + "  - {topic: /b, remote_topic: /c, direction: receive}\n", FILE).topics) == 2
    assert len(parse(text + f"  - {{topic: /b, remote_topic: {of_server}, direction: transmit}}\n", FILE).topics) == 2
    (problem,) = problems(text + f"  - {{topic: /b, remote_topic: {of_server}, direction: receive}}\n")
    assert problem.location == "topics[1].remote_topic"
    assert says(problem.message, SessionMistake.SOURCE_TWICE, name="/a", remote=of_server)


def test_topics_share_port_only_with_different_protocols() -> None:
    text = CLIENT + "topics:\n  - {topic: /a, direction: transmit, port: 5000}\n"
    assert parse(text + "  - {topic: /b, direction: transmit, port: 5000, protocol: udp}\n", FILE)
    (problem,) = problems(text + "  - {topic: /b, direction: transmit, port: 5000, protocol: tcp}\n")
    assert problem.location == "topics[1].port"
    assert says(problem.message, SessionMistake.PORT_TAKEN, protocol="tcp", port=5000, name="/a")


@pytest.mark.parametrize("head", [BLUETOOTH, f"{CLIENT}bluetooth_address: {MAC}\n"])
def test_topics_may_share_a_channel_of_their_own(head: str) -> None:
    topics = [f"  - {{topic: /{name}, direction: transmit, protocol: bluetooth, port: 11}}\n" for name in "ab"]
    assert len(parse(head + "topics:\n" + "".join(topics), FILE).topics) == 2


@pytest.mark.parametrize(
    ("text", "line", "location", "code", "parameters"),
    [
        ("KEY\n", None, "", YamlMistake.KEY_FILE, {}),
        ("Key generated at 01/06/2021 12:00:00:\n\nKEY", None, "", YamlMistake.KEY_FILE, {}),
        ("KEY  # ours\n", 1, "", ValueMistake.FILE_NOT_A_MAPPING, {}),
        ("the key is\nKEY\nkeep it", 1, "", ValueMistake.FILE_NOT_A_MAPPING, {}),
        ("[KEY]", 1, "", ValueMistake.FILE_NOT_A_MAPPING, {}),
        ("KEY: x", 1, "", ValueMistake.NO_KNOWN_KEY, {"model": "session"}),
        (CLIENT + "KEY: x", 6, "<a key>", ValueMistake.UNKNOWN_KEY, {}),
        (CLIENT.replace("key.txt", "KEY"), 5, "key_file", ValueMistake.IS_A_KEY, {}),
        (CLIENT.replace("key.txt", "keys/KEY"), 5, "key_file", ValueMistake.IS_A_KEY, {}),
        (CLIENT.replace("robot1", "KEY") + "use_name: true\n", 1, "name", ValueMistake.IS_A_KEY, {}),
        (CLIENT + "domain_id: KEY\n", 6, "domain_id", ValueMistake.IS_A_KEY, {}),
        (CLIENT + "stale_after: key KEY\n", 6, "stale_after", ValueMistake.MISFIT, {}),
        (CLIENT + "stale_after: [KEY]\n", 6, "stale_after", ValueMistake.MISFIT, {}),
        (CLIENT + "topics: [KEY]\n", 6, "topics[0]", ValueMistake.NOT_A_MAPPING, {"value": "'<a key>'"}),
        (CLIENT + "topics: [{topic: KEY, direction: receive}]\n", 6, "topics[0].topic", ValueMistake.IS_A_KEY, {}),
        (topic("qos: KEY"), 7, "topics[0].qos", ValueMistake.IS_A_KEY, {}),
        (topic("qos: {profile: KEY}"), 7, "topics[0].qos", QosProblem.UNKNOWN_PROFILE, {"value": "<a key>"}),
        (topic("type: KEY"), 7, "topics[0].type", ValueMistake.IS_A_KEY, {}),
        (SERVER + "clients:\n  - {name: a, allow: [KEY]}\n", 7, "clients[0].allow[0]", ValueMistake.IS_A_KEY, {}),
        ("name: !!KEY x\n", 1, "name", YamlMistake.TAG, {"tag": "tag:yaml.org,2002:<a key>"}),
    ],
)
def test_misplaced_key_is_refused_unquoted(
    text: str, line: int | None, location: str, code: Wording, parameters: dict[str, Any]
) -> None:
    key = "VdzT2kwMacThZWkBigjbtte9iRjW8djEJ10JiemVwLM="
    found = problems(text.replace("KEY", key))
    assert any(has(problem, line, location, code, parameters) for problem in found), found
    assert key[:20] not in "".join(refusals(text.replace("KEY", key)))


@pytest.mark.parametrize("text", ["name: !KEY! x\n", "name: *KEY\n"])
def test_key_that_breaks_yaml_is_unquoted(text: str) -> None:
    key = "VdzT2kwMacThZWkBigjbtte9iRjW8djEJ10JiemVwLM="
    (refusal,) = refusals(text.replace("KEY", key))
    assert refusal.startswith("robot1.yaml:1: ")
    assert key[:20] not in refusal


def test_key_without_padding_is_unquoted_long_names_quoted() -> None:
    key = "VdzT2kwMacThZWkBigjbtte9iRjW8djEJ10JiemVwLM"
    (problem,) = problems(CLIENT + f"domain_id: {key}\n")
    assert says(problem.message, ValueMistake.MISFIT, value="'<a key>'")
    long_name = "~/camera/front/left/depth/points/and/others"
    (refusal,) = refusals(topic(f"remote_topic: {long_name}"))
    assert long_name in refusal


@pytest.mark.parametrize(
    ("text", "line", "location", "code", "parameters"),
    [
        ("", None, "", YamlMistake.EMPTY, {}),
        ("# nothing\n", None, "", YamlMistake.EMPTY, {}),
        ("5", 1, "", ValueMistake.FILE_NOT_A_MAPPING, {}),
        ("a: 1\nb: 2\n", 1, "", ValueMistake.NO_KNOWN_KEY, {"model": "session"}),
        ("name: a\n\trole: b\n", 2, "", YamlMistake.TAB, {}),
        ("topics:\n\t- {topic: /a}\n", 2, "", YamlMistake.TAB, {}),
        ("topics:\n  - topic: /a\n  \tdirection: receive\n", 3, "", YamlMistake.TAB, {}),
        ("name: a\nrole client\nserver_ip: x\n", 2, "", YamlMistake.NO_COLON, {"key": "role"}),
        ("name: a\nrole:client\nserver_ip: x\n", 2, "", YamlMistake.NO_COLON, {"key": "role"}),
        ("name a\n\nrole: b\n", 1, "", YamlMistake.NO_COLON, {"key": "name"}),
        (
            "topics:\n  - topic: /a\n    direction transmit\n    port: 3\n",
            3,
            "",
            YamlMistake.NO_COLON,
            {"key": "direction"},
        ),
        (
            "topics:\n  - {topic: /a, direction: transmit\n  - {topic: /b}\n",
            2,
            "",
            YamlMistake.NOT_CLOSED,
            {"begin": "{", "end": "}", "line": 3},
        ),
        ("topics:\n  - {topic: /a,\n  - {topic: /b}\n", 2, "", YamlMistake.NOT_CLOSED, {"begin": "{"}),
        ("ports: [1, 2\nrole: x\n", 1, "", YamlMistake.NOT_CLOSED, {"begin": "[", "end": "]", "line": 2}),
        ("topics:\n- {topic: /a\n", 2, "", YamlMistake.NOT_CLOSED, {"begin": "{", "line": 3}),
        ("name: [1,\n", 1, "", YamlMistake.NOT_CLOSED, {"begin": "["}),
        ("name: 'abc\nrole: x\n", 1, "", YamlMistake.QUOTE_NOT_CLOSED, {}),
        ("name: &a x\nrole: *a\n", 2, "", YamlMistake.ALIAS, {}),
        ("a: &a [*a]\n", 1, "", YamlMistake.ALIAS, {}),
        pytest.param("[" * 5000, 1, "", YamlMistake.TOO_DEEP, {}, id="deep"),
        ("name: a\x07\n", 1, "", YamlMistake.CHARACTER, {"code": 0x7}),
        ("name: !!python/object/apply:os.system [x]\n", 1, "name", YamlMistake.TAG, {}),
    ],
)
def test_a_text_that_is_no_session_is_refused(
    text: str, line: int | None, location: str, code: Wording, parameters: dict[str, Any]
) -> None:
    assert any(has(problem, line, location, code, parameters) for problem in problems(text))


@pytest.mark.parametrize(
    ("text", "line", "words_of_pyyaml"),
    [
        ("topics: [{topic: /a direction: b}]\n", 1, "while parsing a flow mapping"),
        ("name: a: b\n", 1, "mapping values are not allowed here"),
        ("--- {}\n--- {}\n", 2, "expected a single document"),
    ],
)
def test_a_text_that_is_no_yaml_is_refused(text: str, line: int, words_of_pyyaml: str) -> None:
    (problem,) = problems(text)
    assert problem.line == line
    assert problem.message.startswith(words_of_pyyaml)


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"name: a\n\xff\xfe")
    huge = tmp_path / "huge.yaml"
    huge.write_text("#" * (1 << 20) + "\n")
    cases: list[tuple[Path, int | None, Wording, dict[str, Any]]] = [
        (tmp_path / "none.yaml", None, FileProblem.NO_SUCH_FILE, {}),
        (tmp_path / ("x" * 300), None, FileProblem.NOT_READ, {"problem": os.strerror(errno.ENAMETOOLONG)}),
        (tmp_path, None, FileProblem.NOT_A_FILE, {"kind": "a folder"}),
        (Path("/dev/null"), None, FileProblem.NOT_A_FILE, {"kind": "a device"}),
        (binary, 2, FileProblem.NOT_UTF8, {}),
        (huge, None, FileProblem.TOO_LARGE, {"limit": 1048576}),
    ]
    for path, line, code, parameters in cases:
        with pytest.raises(SessionError) as caught:
            load(path)
        (problem,) = caught.value.problems
        assert has(problem, line, "", code, parameters)
        assert str(caught.value).startswith(f"{path}:")


@pytest.mark.parametrize(
    "server_ip", ["80:32:53:10:12:20", "::1", "fe80::1%lo", "robot-1.local", "build_host", "127.0.0.1"]
)
def test_addresses_are_text_without_quotes(server_ip: str) -> None:
    """YAML 1.1 reads the first, a MAC of digits, as a number in base 60."""
    text = f"name: off\nrole: server\nserver_ip: {server_ip}\nserver_port: 5\nkey_file: key.txt\n"
    session = parse(text, FILE)
    assert session.server_ip == server_ip
    assert session.name == "off"
    assert session.is_bluetooth is (server_ip == "80:32:53:10:12:20")


@pytest.mark.parametrize("group", ["''", "' '", '"hall\\e[2J"', "x" * 256, "[hall]", "5"])
def test_groups_are_text(group: str) -> None:
    of_client = f"clients:\n  - {{name: robot1, group: {group}}}\n"
    for text, line, place in (
        (f"{CLIENT}group: {group}\n", 6, "group"),
        (SERVER + of_client, 7, "client robot1, group"),
    ):
        (refusal,) = refusals(text)
        assert f":{line}: {place}: " in refusal


def test_a_group_is_kept() -> None:
    assert parse(f"{CLIENT}group: Halle 3, größere\n", FILE).group == "Halle 3, größere"
    assert parse(f"{SERVER}group: hall\n", FILE).accepted_clients[0].group == "hall"
    session = parse(f"{SERVER}clients:\n  - {{name: robot1, group: yard}}\n  - {{name: robot2}}\n", FILE)
    assert [client.group for client in session.accepted_clients] == ["yard", None]


def test_form_has_same_rules_as_file() -> None:
    (problem,) = validate_topic(Topic(topic="scan", direction="transmit"))
    assert (problem.location, problem.line) == ("topic", None)
    assert says(problem.message, Hint.DID_YOU_MEAN, name="/scan")
    mistyped = Topic(topic="/scan", direction="transmit", protocol="tpc")
    assert [problem.location for problem in validate_topic(mistyped)] == ["protocol"]
    over_tcp = Topic(topic="/scan", direction="transmit", protocol="tcp")
    assert validate_topic(over_tcp) == validate_topic(over_tcp, parse(CLIENT, FILE)) == []
    assert [problem.location for problem in validate_topic(over_tcp, parse(BLUETOOTH, FILE))] == ["protocol"]
    session = Session(name="a", role="client", server_ip="localhost", server_port=0, topics=(mistyped,))
    assert [problem.location for problem in validate(session)] == ["topics[0].protocol", "server_port", "key_file"]
