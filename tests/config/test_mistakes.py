"""What a session file is refused for, and in which words."""

from pathlib import Path

import pytest

from rsb_bridge.config.session_file import SessionError, load, parse, validate, validate_topic
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.sources import ANNOUNCEMENT_TOPIC

FILE = Path("robot1.yaml")
CLIENT = "name: robot1\nrole: client\nserver_ip: 192.168.1.10\nserver_port: 49152\nkey_file: key.txt\n"
SERVER = "name: control\nrole: server\nserver_ip: 0.0.0.0\nserver_port: 49152\nkey_file: key.txt\n"
BLUETOOTH = "name: robot1\nrole: client\nserver_ip: 5C:F3:70:9A:1B:2E\nserver_port: 5\nkey_file: key.txt\n"
MAC = "5C:F3:70:9A:1B:2E"


def refusals(text: str) -> list[str]:
    with pytest.raises(SessionError) as caught:
        parse(text, FILE)
    return str(caught.value).splitlines()


def topic(fields: str, base: str = CLIENT) -> str:
    return f"{base}topics:\n  - {{topic: /scan, direction: transmit, {fields}}}\n"


@pytest.mark.parametrize("text", [CLIENT, SERVER, BLUETOOTH])
def test_the_bases_of_these_tests_are_right(text: str) -> None:
    assert parse(text, FILE).server_ip in text


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (
            topic("protocol: tpc"),
            7,
            "topic /scan, protocol: 'tpc' is not one of tcp, udp, bluetooth, zenoh, zenoh-drop (did you mean tcp?)",
        ),
        (topic("protocol: TCP"), 7, "(did you mean tcp?)"),
        (topic("protcol: tcp"), 7, "topic /scan, protcol: unknown key (did you mean protocol?)"),
        (topic("qos: sensor-data"), 7, "(did you mean sensor_data?)"),
        (topic("qos: 0"), 7, "topic /scan, qos: depth: 0 is out of range: 1 to 100000"),
        (topic("qos: {depth: -1}"), 7, "topic /scan, qos: depth: -1 is out of range"),
        (
            topic("qos: {reliability: reliabel}"),
            7,
            "qos.reliability: 'reliabel' is not one of reliable, best_effort (did",
        ),
        (topic("qos: {realiability: reliable}"), 7, "qos.realiability: unknown key (did you mean reliability?)"),
        (
            topic("qos: {profile: sensor-data}"),
            7,
            "topic /scan, qos: profile: 'sensor-data' is not one of default, sensor",
        ),
        (
            topic("qos: {deadline: 1e400}"),
            7,
            "topic /scan, qos: deadline: inf s is out of range: 0.001 to 1000000000 s, or 0 for none",
        ),
        (topic("qos: 99999999999999999999"), 7, "topic /scan, qos: depth: 99999999999999999999 is out of range"),
        (topic("qos: [1]"), 7, "topic /scan, qos: [1] is not text or a whole number or a mapping"),
        (topic("type: LaserScann"), 7, "did you mean sensor_msgs/msg/LaserScan"),
        (topic("type: sensor_msgs.msg.LaserScan"), 7, "topic /scan, type:"),
        (topic("port: 0"), 7, "topic /scan, port: 0 is not a valid port: 1 to 65535"),
        (topic("port: 65536"), 7, "65536 is not a valid port"),
        (topic("port: '49153'"), 7, "'49153' is not a whole number (leave out the quotes)"),
        (topic("port: 31", BLUETOOTH), 7, "31 is not a valid RFCOMM channel: 1 to 30"),
        (topic("port: 49152"), 7, "49152 is the server_port: leave port out to share it"),
        (topic("protocol: bluetooth"), 7, "bluetooth needs the MAC of the server's adapter: as server_ip"),
        (topic("protocol: udp", BLUETOOTH), 7, "udp does not cross a Bluetooth link"),
        (
            topic("protocol: bluetooth", f"{CLIENT}bluetooth_address: {MAC}\n"),
            8,
            "needs a channel, 1 to 30; several",
        ),
        (topic("protocol: bluetooth, port: 31", f"{CLIENT}bluetooth_address: {MAC}\n"), 8, "31"),
        (f"{CLIENT}bluetooth_address: 10.0.0.1\n", 6, "'10.0.0.1' is not a Bluetooth MAC"),
        (f"{BLUETOOTH}bluetooth_address: {MAC}\n", 6, "server_ip is a Bluetooth MAC already"),
        (topic("max_rate: 0"), 7, "topic /scan, max_rate: 0.0 is out of range"),
        (topic("max_rate: 1e-310"), 7, "topic /scan, max_rate: 1e-310 is out of range: 0.001 to 1000000 Hz"),
        (topic("max_rate: 1e7"), 7, "topic /scan, max_rate: 10000000.0 is out of range"),
        (topic("expected_rate: -1"), 7, "topic /scan, expected_rate:"),
        (topic("expected_rate: 1e-310"), 7, "topic /scan, expected_rate: 1e-310 is out of range"),
        (topic("stale_after: -1"), 7, "topic /scan, stale_after:"),
        (
            topic("stale_after: 1e-300"),
            7,
            "topic /scan, stale_after: 1e-300 is out of range: 0.1 to 1000000 s, or 0 to never warn",
        ),
        (CLIENT + "stale_after: 1e300\n", 6, "stale_after: 1e+300 is out of range"),
        (topic("paused: yes"), 7, "topic /scan, paused: 'yes' is not true or false"),
        (topic("arm: 1"), 7, "topic /scan, arm: 1 is not true or false"),
        (topic("deadman: 30"), 7, "topic /scan, deadman: only a topic that is armed has one: set arm: true"),
        (topic("arm: true, deadman: 1"), 7, "topic /scan, deadman: 1.0 is out of range: 2 to 86400 s, or 0 for none"),
        (
            topic(f"remote_topic: {ANNOUNCEMENT_TOPIC}"),
            7,
            "topic /scan, remote_topic: '/_rsb_bridge/published' is what",
        ),
        (topic("remote_topic: scan"), 7, "topic /scan, remote_topic: 'scan' is not an absolute topic name"),
        (topic("remote_topic: ~/scan"), 7, "(did you mean /scan?)"),
        (topic("remote_topic: /front-scan/2"), 7, "(did you mean /front_scan/_2?)"),
        (topic("topic: /other"), 7, "topic: duplicate key, first on line 7"),
        (CLIENT + "topics:\n  - {topic: scan, direction: transmit}\n", 7, "(did you mean /scan?)"),
        (CLIENT + "topics:\n  - topic: /scan\n", 7, "topic /scan, direction: missing: give one of transmit, receive"),
        (CLIENT + "topics:\n  - /scan\n", 7, "topic 1: '/scan' is not a mapping of topic, direction"),
        (CLIENT + "topics[2]server_ip: x\n", 6, "topics[2]server_ip: unknown key"),
        (CLIENT + "topics: /scan\n", 6, "topics: '/scan' is not a list"),
        (CLIENT + "topics:\n", 6, "topics: has no value"),
        (CLIENT + "name: other\n", 6, "name: duplicate key, first on line 1"),
        (CLIENT + "domain_id: 233\n", 6, "domain_id: 233 is not a ROS domain: 0 to 232"),
        (CLIENT + "stale_after: .inf\n", 6, "stale_after: '.inf' is not a number"),
        (CLIENT + "ports: none\n", 6, "ports: belongs in the server's session file"),
        (SERVER + "ports: [12001, 80]\n", 6, "ports[1]: 80 is no port for a topic: 1024 to 65535"),
        (SERVER + "ports: nine\n", 6, "ports: 'nine' is not none, or a list of whole numbers"),
        (CLIENT + "stale_warnings: -1\n", 6, "stale_warnings: -1 is not a count"),
        (CLIENT + "shutdown_topic: shutdown\n", 6, "shutdown_topic: 'shutdown' is not an absolute topic name"),
        (CLIENT + "metrics: 9464\n", 6, "metrics: 9464 is not text"),
        (CLIENT + "metrics: '9464'\n", 6, "metrics: '9464' is not ADDRESS:PORT"),
        (CLIENT + "metrics: ':9464'\n", 6, "metrics: ':9464' names no address"),
        (CLIENT + "metrics: ::1:9464\n", 6, "metrics: '::1:9464': an IPv6 address stands in brackets"),
        (CLIENT + "metrics: 127.0.0.1:0\n", 6, "metrics: '0' is not a port"),
        (CLIENT + "metrics: a b:9464\n", 6, "metrics: 'a b' is not an IPv4 or IPv6 address"),
        (CLIENT + "clients: [{name: robot2}]\n", 2, "role: a client has no clients"),
        (CLIENT + "encryption_key: abc\n", 6, "a session file never holds the key itself"),
        (CLIENT.replace("robot1", "robot-1") + "use_name: true\n", 1, "cannot be a prefix of topic names"),
        (CLIENT.replace("robot1", "12"), 1, "name: 12 is not text (put it in quotes)"),
        (CLIENT.replace("robot1", "' '"), 1, "is not a name"),
        (CLIENT.replace("robot1", "r" * 256), 1, "name: has 256 bytes in UTF-8, and at most 255 are allowed"),
        (CLIENT.replace("192.168.1.10", "192.168.1"), 3, "server_ip: '192.168.1' is not an IPv4 or IPv6 address"),
        (CLIENT.replace("192.168.1.10", "192.168.1.256"), 3, "is not an IPv4 or IPv6 address"),
        (CLIENT.replace("192.168.1.10", "0.0.0.0"), 3, "a client cannot connect to 0.0.0.0"),
        (CLIENT.replace("192.168.1.10", "5C-F3-70-9A-1B-2E"), 3, "(did you mean 5C:F3:70:9A:1B:2E?)"),
        (BLUETOOTH.replace("port: 5", "port: 31"), 4, "server_port: 31 is not a valid RFCOMM channel"),
        (
            CLIENT.replace("role: client", "role: cleint"),
            2,
            "'cleint' is not one of client, server (did you mean client?)",
        ),
        (CLIENT.replace("key_file: key.txt\n", ""), 1, "key_file: missing: encryption needs a key; make one with"),
        (CLIENT.replace("key_file: key.txt", "key_file: ''"), 5, "key_file: '' is not a file name"),
        (CLIENT.replace("key_file: key.txt", r'key_file: "k\0y"'), 5, r"key_file: 'k\x00y' is not a file name"),
        (
            SERVER + 'clients:\n  - {name: a, allow: ["/\\ud800"]}\n',
            7,
            "client a, allow[0]: '/\\ud800' matches no topic",
        ),
        (SERVER + "topics: [{topic: /a, direction: receive}]\n", 2, "role: a server has no topics"),
        (
            SERVER + "clients:\n  - {name: a}\n  - {name: a}\n",
            8,
            "client a, name: 'a' is the name of client number 1 already",
        ),
        (
            SERVER + "clients:\n  - name: a\n    topics:\n      - {topic: /b, direction: transmit, protocol: tpc}\n",
            9,
            "client a, topic /b, protocol: 'tpc' is not one of tcp, udp, bluetooth",
        ),
        (
            SERVER + "clients:\n  - name: a\n    topics:" + 2 * "\n    - {topic: /b, direction: transmit}",
            10,
            "client a, topic /b: /b (transmit) is there already, as number 1",
        ),
        (SERVER + "clients:\n  - {name: a, allow: [scan]}\n", 7, "client a, allow[0]: 'scan' matches no topic"),
        (SERVER + "clients:\n  - {name: a, deny: scan}\n", 7, "client a, deny: 'scan' is not a list"),
        (SERVER + "clients:\n  - {name: a b, use_name: true}\n", 7, "client a b, name: 'a b' cannot be a prefix"),
        (SERVER.replace("key_file: key.txt\n", "clients: [{name: a}]\n"), 5, "client a, key_file: missing"),
        (SERVER + "next_key_file: key.txt\n", 6, "next_key_file: 'key.txt' is the key_file already"),
        (SERVER + "next_key_file: ''\n", 6, "next_key_file: '' is not a file name"),
        (CLIENT + "next_key_file: new.key\n", 6, "next_key_file: belongs in the server's session file"),
        (
            SERVER.replace("key_file: key.txt", "next_key_file: b\nclients: [{name: a, key_file: a.key}]"),
            5,
            "next_key_file: there is no key_file beside it, which it would replace",
        ),
        (
            SERVER + "clients:\n  - {name: a, key_file: a.key, next_key_file: a.key}\n",
            7,
            "client a, next_key_file: 'a.key' is the key_file already",
        ),
        (
            SERVER + "clients:\n  - {name: a, next_key_file: key.txt}\n",
            7,
            "client a, next_key_file: 'key.txt' is the key_file already",
        ),
    ],
)
def test_a_mistake_is_named_with_its_line_and_what_would_be_right(text: str, line: int, words: str) -> None:
    (refusal,) = refusals(text)
    assert refusal.startswith(f"robot1.yaml:{line}: ")
    assert words in refusal


def test_every_mistake_of_a_file_comes_at_once_in_its_order() -> None:
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


def test_a_mistake_is_not_held_against_what_rests_on_it() -> None:
    """A mistyped direction could be either: it makes no duplicate of the topic's other direction."""
    found = refusals(CLIENT + "topics:\n  - {topic: /a, direction: transmit}\n  - {topic: /a, direction: recieve}\n")
    assert len(found) == 1
    assert "topic /a, direction" in found[0]


def test_the_same_topic_twice_in_one_direction_is_refused_and_both_ways_is_not() -> None:
    both = CLIENT + "topics:\n  - {topic: /a, direction: transmit}\n  - {topic: /a, direction: receive}\n"
    assert len(parse(both, FILE).topics) == 2
    (refusal,) = refusals(both + "  - {topic: /a, direction: receive, protocol: udp}\n")
    assert refusal.startswith("robot1.yaml:9: topic /a: /a (receive) is there already, as number 2")


@pytest.mark.parametrize("use_name", ["", "use_name: true\n"])
def test_one_topic_of_the_server_cannot_come_under_two_names(use_name: str) -> None:
    """The bridge refuses such a route, and did not start."""
    of_server = "/robot1/a" if use_name else "/a"
    text = CLIENT + use_name + "topics:\n  - {topic: /a, direction: receive}\n"
    assert len(parse(text + "  - {topic: /b, remote_topic: /c, direction: receive}\n", FILE).topics) == 2
    assert len(parse(text + f"  - {{topic: /b, remote_topic: {of_server}, direction: transmit}}\n", FILE).topics) == 2
    (refusal,) = refusals(text + f"  - {{topic: /b, remote_topic: {of_server}, direction: receive}}\n")
    assert f"topic /b, remote_topic: /a comes from the server's {of_server}, too" in refusal


def test_two_topics_cannot_have_one_port_of_their_own_unless_protocols_differ() -> None:
    text = CLIENT + "topics:\n  - {topic: /a, direction: transmit, port: 5000}\n"
    assert parse(text + "  - {topic: /b, direction: transmit, port: 5000, protocol: udp}\n", FILE)
    (refusal,) = refusals(text + "  - {topic: /b, direction: transmit, port: 5000, protocol: tcp}\n")
    assert "topic /b, port: tcp port 5000 is taken by /a" in refusal


@pytest.mark.parametrize("head", [BLUETOOTH, f"{CLIENT}bluetooth_address: {MAC}\n"])
def test_topics_may_share_a_channel_of_their_own(head: str) -> None:
    topics = [f"  - {{topic: /{name}, direction: transmit, protocol: bluetooth, port: 11}}\n" for name in "ab"]
    assert len(parse(head + "topics:\n" + "".join(topics), FILE).topics) == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("KEY\n", "robot1.yaml: this is a key file, not a session"),
        ("Key generated at 01/06/2021 12:00:00:\n\nKEY", "robot1.yaml: this is a key file, not a session"),
        ("KEY  # ours\n", "robot1.yaml:1: is not a mapping of name, role"),
        ("the key is\nKEY\nkeep it", "robot1.yaml:1: is not a mapping of name, role"),
        ("[KEY]", "robot1.yaml:1: is not a mapping of name, role"),
        ("KEY: x", "robot1.yaml:1: has no key of a session: name, role"),
        (CLIENT + "KEY: x", "robot1.yaml:6: <a key>: unknown key"),
        (CLIENT.replace("key.txt", "KEY"), "robot1.yaml:5: key_file: is a key itself"),
        (CLIENT.replace("key.txt", "keys/KEY"), "robot1.yaml:5: key_file: is a key itself"),
        (CLIENT.replace("robot1", "KEY") + "use_name: true\n", "robot1.yaml:1: name: is a key itself"),
        (CLIENT + "domain_id: KEY\n", "robot1.yaml:6: domain_id: is a key itself"),
        (CLIENT + "stale_after: key KEY\n", "robot1.yaml:6: stale_after: 'key <a key>' is not a number"),
        (CLIENT + "stale_after: [KEY]\n", "robot1.yaml:6: stale_after: ['<a key>'] is not a number"),
        (CLIENT + "topics: [KEY]\n", "robot1.yaml:6: topic 1: '<a key>' is not a mapping"),
        (
            CLIENT + "topics: [{topic: KEY, direction: receive}]\n",
            "robot1.yaml:6: topic <a key>, topic: is a key",
        ),
        (topic("qos: KEY"), "robot1.yaml:7: topic /scan, qos: is a key itself"),
        (topic("qos: {profile: KEY}"), "robot1.yaml:7: topic /scan, qos: profile: '<a key>' is not one of"),
        (topic("type: KEY"), "robot1.yaml:7: topic /scan, type: is a key itself"),
        (SERVER + "clients:\n  - {name: a, allow: [KEY]}\n", "robot1.yaml:7: client a, allow[0]: is a key itself"),
        ("name: !!KEY x\n", "robot1.yaml:1: name: the tag tag:yaml.org,2002:<a key> is not allowed"),
        ("name: !KEY! x\n", "robot1.yaml:1: while scanning a tag"),
        ("name: *KEY\n", "robot1.yaml:1: while scanning an alias"),
    ],
)
def test_a_key_in_a_wrong_place_is_refused_without_being_quoted(text: str, words: str) -> None:
    key = "VdzT2kwMacThZWkBigjbtte9iRjW8djEJ10JiemVwLM="
    found = refusals(text.replace("KEY", key))
    assert any(refusal.startswith(words) for refusal in found), found
    assert key[:20] not in "".join(found)


def test_a_key_that_lost_its_padding_is_not_quoted_either_and_long_names_are() -> None:
    key = "VdzT2kwMacThZWkBigjbtte9iRjW8djEJ10JiemVwLM"
    (refusal,) = refusals(CLIENT + f"domain_id: {key}\n")
    assert "domain_id: '<a key>' is not a whole number" in refusal
    long_name = "~/camera/front/left/depth/points/and/others"
    (refusal,) = refusals(topic(f"remote_topic: {long_name}"))
    assert long_name in refusal


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "robot1.yaml: the file is empty"),
        ("# nothing\n", "robot1.yaml: the file is empty"),
        ("5", "robot1.yaml:1: is not a mapping of name, role"),
        ("a: 1\nb: 2\n", "robot1.yaml:1: has no key of a session: name, role, server_ip"),
        ("name: [1,\n", "robot1.yaml:2: while parsing a flow node"),
        ("name: a\n\trole: b\n", "robot1.yaml:2: begins with a tab: use spaces"),
        ("topics:\n\t- {topic: /a}\n", "robot1.yaml:2: begins with a tab: use spaces"),
        ("topics:\n  - topic: /a\n  \tdirection: receive\n", "robot1.yaml:3: begins with a tab: use spaces"),
        ("name: a: b\n", "robot1.yaml:1: mapping values are not allowed here"),
        ("name: &a x\nrole: *a\n", "robot1.yaml:2: aliases (*) are not allowed"),
        ("a: &a [*a]\n", "robot1.yaml:1: aliases (*) are not allowed"),
        pytest.param("[" * 5000, "robot1.yaml:1: nested too deeply", id="deep"),
        ("name: a\x07\n", "robot1.yaml:1: character U+0007 is not allowed"),
        ("--- {}\n--- {}\n", "robot1.yaml:2: expected a single document"),
        ("name: !!python/object/apply:os.system [x]\n", "robot1.yaml:1: name: the tag tag:yaml.org"),
    ],
)
def test_what_is_no_session_at_all_is_refused_in_words(text: str, words: str) -> None:
    assert any(line.startswith(words) for line in refusals(text))


def test_files_that_cannot_be_read_are_refused_in_words(tmp_path: Path) -> None:
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"name: a\n\xff\xfe")
    huge = tmp_path / "huge.yaml"
    huge.write_text("#" * (1 << 20) + "\n")
    for path, words in [
        (tmp_path / "none.yaml", ": no such file"),
        (tmp_path, ": is a folder, not a file"),
        (Path("/dev/null"), ": is a device, not a file"),
        (binary, ":2: is not UTF-8 text"),
        (huge, ": larger than 1048576 bytes"),
    ]:
        with pytest.raises(SessionError) as caught:
            load(path)
        assert str(caught.value).startswith(f"{path}{words}")


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


def test_a_form_has_the_same_rules_as_a_file() -> None:
    (problem,) = validate_topic(Topic(topic="scan", direction="transmit"))
    assert (problem.location, problem.line) == ("topic", None)
    assert "did you mean /scan?" in problem.message
    mistyped = Topic(topic="/scan", direction="transmit", protocol="tpc")  # type: ignore[arg-type]
    assert [problem.location for problem in validate_topic(mistyped)] == ["protocol"]
    over_tcp = Topic(topic="/scan", direction="transmit", protocol="tcp")
    assert validate_topic(over_tcp) == validate_topic(over_tcp, parse(CLIENT, FILE)) == []
    assert [problem.location for problem in validate_topic(over_tcp, parse(BLUETOOTH, FILE))] == ["protocol"]
    session = Session(name="a", role="client", server_ip="localhost", server_port=0, topics=(mistyped,))
    assert [problem.location for problem in validate(session)] == ["topics[0].protocol", "server_port", "key_file"]
