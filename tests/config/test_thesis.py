"""The thesis's bringup.yaml becomes a session that bridges the same topics."""

from pathlib import Path

import pytest

from rsb_bridge.config.session_file import SessionError, dump, parse, validate
from rsb_bridge.config.thesis import import_bringup
from rsb_bridge.model.session import Session, Topic

CLIENT = """\
client_node:
  ros__parameters:
    server_ip: '192.168.10.250'
    server_port: 3000

    receive_topics: ['initialpose', 'goal_pose']
    receive_msg_types: ['PoseWithCovarianceStamped', 'PoseStamped']
    receive_ports: [12002, 12012]
    receive_protocols: ['UDP', 'UDP']
    receive_qos: ['qos_profile_system_default', '10']

    transmit_topics: ['scan', 'robot1/odom', 'tf']
    transmit_msg_types: ['LaserScan', 'Odometry', 'TFMessage']
    transmit_ports: [12004, 12005, 12006]
    transmit_protocols: ['TCP', 'UDP', 'TCP']
    transmit_qos: ['qos_profile_sensor_data', 'qos_profile_default', 'qos_profile_parameters']
"""
BLUETOOTH = """\
client_node:
  ros__parameters:
    server_ip: '80:32:53:E0:12:C0'
    server_port: 8
    receive_topics: ['goal_pose']
    receive_msg_types: ['PoseStamped']
    receive_ports: [14]
    receive_protocols: ['BLUETOOTH']
    receive_qos: ['qos_profile_sensor_data']
    transmit_topics: ['scan', 'shutdown']
    transmit_msg_types: ['LaserScan', 'String']
    transmit_ports: [12001, 18]
    transmit_protocols: ['BLUETOOTH', 'BLUETOOTH']
    transmit_qos: ['qos_profile_sensor_data', '10']
"""
SERVER = "server_node:\n  ros__parameters:\n    server_ip: '192.168.10.250'\n"


@pytest.fixture
def bringup(tmp_path: Path) -> Path:
    path = tmp_path / "bringup.yaml"
    path.write_text(CLIENT)
    return path


def test_a_client(bringup: Path) -> None:
    session, notes = import_bringup(bringup, name="fleet1/robot1", key_file="key.txt", domain_id=3)
    assert session == Session(
        name="fleet1/robot1",
        role="client",
        server_ip="192.168.10.250",
        server_port=3000,
        domain_id=3,
        key_file="key.txt",
        topics=(
            Topic("/scan", "transmit", "sensor_msgs/msg/LaserScan", "tcp", 12004, "sensor_data"),
            Topic("/robot1/odom", "transmit", "nav_msgs/msg/Odometry", "udp", 12005, "default"),
            Topic("/tf", "transmit", "tf2_msgs/msg/TFMessage", "tcp", 12006, "parameters"),
            Topic(
                "/initialpose", "receive", "geometry_msgs/msg/PoseWithCovarianceStamped", "udp", 12002, "system_default"
            ),
            Topic("/goal_pose", "receive", "geometry_msgs/msg/PoseStamped", "udp", 12012, 10),
        ),
    )
    assert notes == []
    assert validate(session) == []
    assert parse(dump(session), bringup) == session


def test_the_other_side_of_a_clients_file(bringup: Path) -> None:
    session, notes = import_bringup(bringup, name="robot1", role="server", key_file="key.txt", use_name=True)
    assert (session.role, session.server_ip, session.server_port) == ("server", "192.168.10.250", 3000)
    assert session.topics == ()
    assert notes == ["the topics are left out: a server gets them from its clients"]


def test_a_server(bringup: Path) -> None:
    bringup.write_text(SERVER)
    session, _ = import_bringup(bringup, name="robot1", server_port=13001, use_encryption=False)
    assert session == Session(
        name="robot1", role="server", server_ip="192.168.10.250", server_port=13001, use_encryption=False
    )
    with pytest.raises(SessionError, match="server_port: missing"):
        import_bringup(bringup, name="robot1", key_file="key.txt")


def test_bluetooth_leaves_out_what_rfcomm_or_the_session_does_itself(bringup: Path) -> None:
    bringup.write_text(BLUETOOTH)
    session, notes = import_bringup(bringup, name="robot1", key_file="key.txt")
    assert session.is_bluetooth
    assert [(topic.topic, topic.port) for topic in session.topics] == [("/scan", None), ("/goal_pose", 14)]
    assert notes == [
        "/scan: 12001 is not an RFCOMM channel; the topic shares the link's",
        "/shutdown is left out: the session's shutdown_topic does what it did",
    ]


def test_what_changed_is_said(bringup: Path) -> None:
    bringup.write_text(CLIENT + "    use_sim_time: true\n")
    _, notes = import_bringup(bringup, name="robot1", key_file="key.txt", use_name=True)
    assert notes[0] == "use_sim_time: not a parameter of the bridge, left out"
    assert "named /robot1/... on the server" in notes[1]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("'TCP', 'UDP', 'TCP'", "'TCP', 'TPC', 'TCP'", "15: client_node.ros__parameters.transmit_protocols[1]: 'tpc'"),
        ("[12002, 12012]", "[12002]", "8: client_node.ros__parameters.receive_ports: 1 entries for 2 receive_topics"),
        ("[12002, 12012]", "12002", "8: client_node.ros__parameters.receive_ports: 12002 is not a list"),
        ("'10'", "'qos_sensor'", "10: client_node.ros__parameters.receive_qos[1]: 'qos_sensor' is not one of"),
        ("'Odometry'", "'Odometri'", "13: client_node.ros__parameters.transmit_msg_types[1]: 'Odometri'"),
        ("'goal_pose'", "'goal-pose'", "6: client_node.ros__parameters.receive_topics[1]: '/goal-pose'"),
        ("12006", "12004", "14: client_node.ros__parameters.transmit_ports[2]: tcp port 12004 is taken by"),
        ("'192.168.10.250'", "'192.168.10'", "3: client_node.ros__parameters.server_ip: '192.168.10' is not"),
        ("ros__parameters", "parameters", " not a bringup.yaml of ros2_socket_bridge"),
        (
            CLIENT,
            "client_node:\n  ros__parameters:\n    server_ip: '10.0.0.1'\n    server_port: 3000\n    topics: [scan]\n",
            "2: client_node.ros__parameters: no topics: a client has the lists transmit_topics and receive_topics",
        ),
        (CLIENT, "- a list\n", " not a bringup.yaml of ros2_socket_bridge"),
        (CLIENT, CLIENT + SERVER, " 2 nodes have a server_ip: client_node, server_node"),
    ],
)
def test_mistakes_are_placed_in_the_thesis_file(bringup: Path, old: str, new: str, words: str) -> None:
    bringup.write_text(CLIENT.replace(old, new))
    with pytest.raises(SessionError) as caught:
        import_bringup(bringup, name="robot1", key_file="key.txt")
    assert str(caught.value).startswith(f"{bringup}:{words}")
    assert len(caught.value.problems) == 1


def test_mistakes_of_the_arguments_have_no_line(bringup: Path) -> None:
    with pytest.raises(SessionError) as caught:
        import_bringup(bringup, name="robot1", server_port=0)
    assert {(problem.location, problem.line) for problem in caught.value.problems} == {
        ("client_node.ros__parameters.server_port", 4),
        ("key_file", None),
    }
