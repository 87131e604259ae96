"""Files of domain_bridge and zenoh-bridge-ros2dds become sessions that bridge the same names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.support.commands import rsb_console
from tests.support.foreign_files import DOMAINS, ZENOH
from tests.support.wording import says

from rsb_bridge.config.rights import rights_of_client
from rsb_bridge.config.session_file import SessionError, dump, load, parse, same
from rsb_bridge.model.patterns import Pattern, is_valid
from rsb_bridge.model.session import Client, Grant, Topic
from rsb_extras.imports.domain_bridge import DomainBridgeMistake, DomainBridgeNote
from rsb_extras.imports.importing import ImportMistake, import_file
from rsb_extras.imports.name_expressions import globs, patterns
from rsb_extras.imports.other_bridges import Choices, Imported, OtherFile
from rsb_extras.imports.zenoh_bridge import ZenohBridgeMistake, ZenohBridgeNote


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def imported(text: str, suffix: str = "yaml", **choices: Any) -> Imported:
    path = Path(f"bridge.{suffix}")
    path.write_text(text)
    return import_file(path, Choices(**choices))


def mistakes(text: str, **choices: Any) -> list[tuple[str, int | None, str]]:
    with pytest.raises(SessionError) as caught:
        imported(text, **choices)
    return [(each.location, each.line, each.message) for each in caught.value.problems]


def test_domain_pair_becomes_client_and_server() -> None:
    sessions, notes, keys = imported(DOMAINS)
    assert list(sessions) == ["hall-domain2", "hall-domain3"]
    client, server = sessions.values()
    assert [(each.role, each.domain_id) for each in (client, server)] == [("client", 2), ("server", 3)]
    assert {(each.name, each.server_ip, each.server_port, each.key_file) for each in (client, server)} == {
        ("hall", "127.0.0.1", 7060, "hall.key")
    }
    assert keys == ("hall.key",)
    qos = {
        "reliability": "best_effort", "durability": "volatile", "depth": 5, "deadline": 0.5,
        "liveliness": "manual_by_topic", "liveliness_lease_duration": 2.0,
    }  # fmt: skip
    assert client.topics == (
        Topic("/clock", "transmit", "rosgraph_msgs/msg/Clock"),
        Topic("/battery", "transmit", "sensor_msgs/msg/BatteryState", qos=qos, remote_topic="/hall/battery"),
        Topic("/goal_pose", "receive", "geometry_msgs/msg/PoseStamped"),
        Topic("/chat", "transmit", "std_msgs/msg/String"),
        Topic("/chat", "receive", "std_msgs/msg/String"),
    )
    assert notes == []
    assert not server.topics


def test_each_domain_pair_is_a_link() -> None:
    text = DOMAINS + "  chat:\n    type: std_msgs/msg/String\n    to_domain: 4\n"
    sessions, _, keys = imported(text, server_port=5000)
    assert list(sessions) == ["hall_2_3-domain2", "hall_2_3-domain3", "hall_2_4-domain2", "hall_2_4-domain4"]
    assert [each.server_port for each in sessions.values()] == [5000, 5000, 5001, 5001]
    assert [each.topic for each in sessions["hall_2_4-domain2"].topics] == ["/chat"]
    assert keys == ("hall_2_3.key", "hall_2_4.key")


def test_remapped_receiving_topic_is_named_at_both_ends() -> None:
    text = "from_domain: 2\nto_domain: 3\ntopics: {a: {type: std_msgs/msg/String}, b: {type: std_msgs/msg/String, "
    sessions, *_ = imported(text + "remap: c, reversed: true}}\n")
    assert sessions["bridge-domain2"].topics[1] == Topic("/c", "receive", "std_msgs/msg/String", remote_topic="/b")


@pytest.mark.parametrize(
    ("qos", "note"),
    [
        ("{depth: 5}", DomainBridgeNote.POLICY_LEFT_OUT),
        ("{reliability: reliable}", DomainBridgeNote.POLICY_ASSUMED),
        ("{reliability: reliable, durability: volatile, lifespan: auto}", DomainBridgeNote.AUTO_TIME),
        ("{reliability: reliable, durability: volatile, partition: cell}", DomainBridgeNote.LEFT_OUT),
    ],
)
def test_lost_policies_are_noted(qos: str, note: DomainBridgeNote) -> None:
    text = f"from_domain: 2\nto_domain: 3\ntopics: {{a: {{type: std_msgs/msg/String, qos: {qos}}}}}\n"
    _, notes, _ = imported(text)
    assert len(notes) == 1
    assert says(notes[0], note)


def test_compressing_mode_compresses_between_bridges() -> None:
    sessions, notes, _ = imported("mode: compress\n" + DOMAINS)
    assert {each.compression for each in sessions["hall-domain2"].topics} == {"zstd"}
    assert any(says(note, DomainBridgeNote.COMPRESSES, mode="compress") for note in notes)


@pytest.mark.parametrize(
    ("text", "location", "line", "mistake"),
    [
        ("from_domain: 2\ntopics: {}\n", "topics", 2, DomainBridgeMistake.NO_TOPICS),
        ("from_domain: 2\ntopics:\n  a: {type: T}\n", "topics.a.to_domain", 3, DomainBridgeMistake.NO_DOMAIN),
        ("from_domain: 2\nto_domain: x\ntopics:\n  a: {}\n", "topics.a.to_domain", 4, DomainBridgeMistake.NOT_A_DOMAIN),
        ("from_domain: 2\nto_domain: 2\ntopics:\n  a: {}\n", "topics.a.to_domain", 4, DomainBridgeMistake.SAME_DOMAIN),
        ("from_domain: 2\nto_domain: 3\ntopics:\n  a: {}\n  a: {}\n", "topics.a", 5, DomainBridgeMistake.TWICE),
        ("from_domain: 2\nto_domain: 3\ntopics:\n  a: 1\n", "topics.a", 4, DomainBridgeMistake.NOT_A_MAPPING),
    ],
)
def test_domain_bridge_mistakes_have_lines(text: str, location: str, line: int, mistake: DomainBridgeMistake) -> None:
    ((where, at, message),) = mistakes(text)
    assert (where, at) == (location, line)
    assert says(message, mistake)


def test_mistake_of_session_has_line_of_topic() -> None:
    text = DOMAINS.replace("std_msgs/msg/String", "no type")
    assert ("topics.chat.type", 15) in [(where, line) for where, line, _ in mistakes(text)]


def test_zenoh_client_lists_what_it_allows() -> None:
    sessions, notes, _ = imported(ZENOH, key_file="robot1.key")
    session = sessions[""]
    assert (session.name, session.role, session.server_ip, session.domain_id) == ("robot1", "client", "192.168.1.10", 7)
    assert (session.use_name, session.server_port) == (True, 7060)
    assert session.topics == (
        Topic("/**/scan", "transmit", max_rate=5.0, priority="high"),
        Topic("/map", "transmit", priority="low"),
        Topic("/tf", "transmit", max_rate=10.0),
        Topic("/cmd_vel", "receive"),
        Topic("/**/light", "receive", kind="service", timeout=8.0),
        Topic("/dock", "receive", kind="action"),
    )
    for note in (ZenohBridgeNote.ADDRESS, ZenohBridgeNote.NAMESPACE_AS_NAME, ZenohBridgeNote.TIMEOUTS):
        assert any(says(each, note) for each in notes), note


def test_zenoh_client_without_lists_bridges_all_but_denied() -> None:
    text = ZENOH[: ZENOH.index("    allow")] + (
        "    deny: {publishers: ['/rosout', '.*/debug.*']}\n    pub_max_frequencies: ['/tf=10']\n"
        "connect: {endpoints: ['tcp/[::1]:7447']}\n"
    )
    sessions, notes, _ = imported(text, use_encryption=False)
    session = sessions[""]
    assert session.server_ip == "::1"
    assert session.topics[:2] == (
        Topic("/tf", "transmit", max_rate=10.0),
        Topic("/**", "transmit", excepts=("/rosout", "/**/debug*", "/**/debug*/**")),
    )
    assert {(each.kind, each.direction) for each in session.topics} == {
        (kind, direction) for kind in ("topic", "service", "action") for direction in ("transmit", "receive")
    }
    assert any(says(each, ZenohBridgeNote.ALL_NAMES) for each in notes)


def test_zenoh_server_list_becomes_rights() -> None:
    sessions, _, _ = imported(ZENOH, name="robot1", role="server", key_file="robot1.key")
    session = sessions[""]
    assert (session.role, session.server_ip) == ("server", "0.0.0.0")
    assert session.clients == (
        Client(
            "robot1",
            allow=(
                Grant("*/scan", may="read", max_rate=5.0),
                Grant("/map", may="read"),
                Grant("/tf", may="read", max_rate=10.0),
                Grant("/cmd_vel", may="publish"),
                Grant(services="*/light", may="call"),
                Grant(services="/dock", may="call"),
            ),
        ),
    )


@pytest.mark.parametrize("names", ["'/cmd_[a-z]+'", ""])
def test_zenoh_server_that_allows_nothing_denies_all(names: str) -> None:
    text = f"plugins: {{ros2dds: {{allow: {{publishers: [{names}]}}}}}}\n"
    sessions, notes, _ = imported(text, name="robot1", key_file="robot1.key")
    rights = rights_of_client(sessions[""].accepted_clients[0], "control")
    assert not rights.shows("/cmd_vel")
    assert not rights.shows("/dock", "service")
    assert any(says(each, ZenohBridgeNote.NOTHING_ALLOWED) for each in notes)


@pytest.mark.parametrize("rule", [".*", "/secret", ".*/image"])
def test_zenoh_rate_allows_nothing_more(rule: str) -> None:
    text = f"plugins: {{ros2dds: {{allow: {{publishers: [/scan, '/cam/.*']}}, pub_max_frequencies: ['{rule}=5']}}}}\n"
    sessions, _, _ = imported(text, name="robot1", key_file="robot1.key")
    rights = rights_of_client(sessions[""].accepted_clients[0], "control")
    assert rights.shows("/scan")
    assert rights.shows("/cam/image")
    assert not rights.shows("/secret")
    assert not rights.shows("/other/image")


def test_zenoh_json5_is_read() -> None:
    pytest.importorskip("zenoh")
    text = """// a robot
    {plugins: {ros2dds: {namespace: '/robot1', allow: {publishers: ["/scan"],},},},
     connect: {endpoints: ["tcp/10.0.0.1:7447"]}}"""
    sessions, _, _ = imported(text, "json5", key_file="robot1.key")
    assert sessions[""].topics == (Topic("/scan", "transmit"),)
    with pytest.raises(SessionError) as caught:
        imported("{plugins: ", "json5")
    assert says(caught.value.problems[0].message, ImportMistake.NOT_JSON5)


@pytest.mark.parametrize(
    ("settings", "location", "mistake"),
    [
        ("allow: {publishers: [a]}, deny: {publishers: [b]}", "allow", ZenohBridgeMistake.BOTH_LISTS),
        ("allow: {publishers: /scan}", "allow.publishers", ZenohBridgeMistake.NOT_A_LIST),
        ("allow: 1", "allow", ZenohBridgeMistake.NOT_A_MAPPING),
        ("pub_max_frequencies: [/scan]", "pub_max_frequencies", ZenohBridgeMistake.NOT_A_SETTING),
    ],
)
def test_zenoh_mistakes_name_the_key(settings: str, location: str, mistake: ZenohBridgeMistake) -> None:
    text = f"plugins: {{ros2dds: {{{settings}}}}}\nconnect: {{endpoints: [tcp/10.0.0.1:7447]}}\n"
    where, _, message = mistakes(text, key_file="robot1.key")[0]
    assert where == location
    assert says(message, mistake)


def test_unknown_expression_is_noted() -> None:
    _, notes, _ = imported(ZENOH.replace("/cmd_vel", "/cmd_[a-z]+"), key_file="robot1.key")
    assert any(says(each, ZenohBridgeNote.EXPRESSION, expression="/cmd_[a-z]+") for each in notes)


@pytest.mark.parametrize(
    ("expression", "names", "others"),
    [
        (".*/scan", ["/scan", "/a/b/scan"], ["/scanner", "/scan/x"]),
        (".*scan.*", ["/scan", "/a/my_scan", "/scans/x/y"], ["/map"]),
        ("/robot.*", ["/robot1", "/robot", "/robot1/x/y"], ["/a/robot"]),
        ("^/a/[^/]*/scan$", ["/a/b/scan"], ["/a/b/c/scan", "/a/scan"]),
        ("/camera/.*|/tf", ["/camera/x", "/camera/x/y", "/tf"], ["/camera"]),
        ("/(left|right)/(?:image|info)", ["/left/image", "/right/info"], ["/left/raw"]),
        (r"/v1\.0", [], ["/v1_0"]),
        (".*", ["/a", "/a/b"], []),
        ("/cam.*/raw", ["/cam/raw", "/cam1/x/raw"], ["/x/raw"]),
    ],
)
def test_expression_and_patterns_match_same_names(expression: str, names: list[str], others: list[str]) -> None:
    found = [each for each in patterns(expression) or [] if is_valid(each)]
    for name in names:
        assert any(Pattern(each).match(name) is not None for each in found), name
    for name in others:
        assert not any(Pattern(each).match(name) is not None for each in found), name


@pytest.mark.parametrize("expression", ["/a(b", "/a{2}", "[a-z]+", "", "/a)", "(a|b)" * 6, "/a?", r"/\w+"])
def test_other_expressions_have_no_patterns(expression: str) -> None:
    assert patterns(expression) is None
    assert globs(expression) is None


def test_import_of_several_domains_writes_a_folder() -> None:
    Path("bridge.yaml").write_text(DOMAINS)
    run = rsb_console("import", "bridge.yaml", "-o", "hall")
    assert run.returncode == 0, run.stderr
    client, server = (load(Path(f"hall/hall-domain{domain}.yaml")) for domain in (2, 3))
    assert (client.role, server.role) == ("client", "server")
    assert Path("hall/hall.key").stat().st_mode & 0o777 == 0o600
    assert rsb_console("check", "hall/hall-domain2.yaml").returncode == 0
    assert rsb_console("import", "bridge.yaml", "-o", "hall").returncode == 1
    assert rsb_console("import", "bridge.yaml", "-o", "hall", "--force").returncode == 0


def test_notes_are_comments_of_the_session() -> None:
    Path("bridge.yaml").write_text(ZENOH)
    run = rsb_console("import", "bridge.yaml", "--no-encryption", "-o", "robot1.yaml")
    assert run.returncode == 0
    comments = [line[2:] for line in Path("robot1.yaml").read_text().splitlines() if line.startswith("# ")]
    assert comments
    assert all(f"rsb-console: {each}" in run.stderr for each in comments)
    session = load(Path("robot1.yaml"))
    assert same(parse(dump(session, comments), Path("robot1.yaml")), session)


@pytest.mark.parametrize(("text", "origin"), [(DOMAINS, "domain_bridge"), (ZENOH, "zenoh-bridge-ros2dds")])
def test_foreign_file_leads_to_the_import(text: str, origin: str) -> None:
    Path("bridge.yaml").write_text(text)
    run = rsb_console("check", "bridge.yaml")
    assert run.returncode == 2
    assert says(run.stderr, OtherFile.CONVERT, origin=origin, path="bridge.yaml")


def test_import_asks_for_missing_key_and_address() -> None:
    Path("bridge.yaml").write_text("plugins: {ros2dds: {}}\n")
    run = rsb_console("import", "bridge.yaml", "--role", "client")
    assert run.returncode == 2
    assert "--key-file" in run.stderr
    assert "server_ip" in run.stderr
