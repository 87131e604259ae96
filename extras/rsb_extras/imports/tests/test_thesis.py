"""The thesis's bringup.yaml becomes a session that bridges the same topics."""

from pathlib import Path
from typing import Any

import pytest
from tests.support.wording import says

from rsb_bridge.config.decoding import ValueMistake
from rsb_bridge.config.name_rules import NameMistake
from rsb_bridge.config.session_file import SessionError, dump, parse, validate
from rsb_bridge.config.validation import SessionMistake
from rsb_bridge.model.qos import QosProblem
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.type_names import TypeNameProblem
from rsb_bridge.model.wording import Wording
from rsb_extras.imports.importing import ImportMistake, import_file
from rsb_extras.imports.other_bridges import Choices
from rsb_extras.imports.thesis import BringupMistake, BringupNote

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


def imported(path: Path, **choices: Any) -> tuple[Session, list[str]]:
    sessions, notes, _ = import_file(path, Choices(**choices))
    (session,) = sessions.values()
    return session, notes


@pytest.fixture
def bringup(tmp_path: Path) -> Path:
    path = tmp_path / "bringup.yaml"
    path.write_text(CLIENT)
    return path


def test_a_client(bringup: Path) -> None:
    session, notes = imported(bringup, name="fleet1/robot1", key_file="key.txt", domain_id=3)
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
    session, notes = imported(bringup, name="robot1", role="server", key_file="key.txt", use_name=True)
    assert (session.role, session.server_ip, session.server_port) == ("server", "192.168.10.250", 3000)
    assert session.topics == ()
    assert notes == [BringupNote.TOPICS_LEFT_OUT()]


def test_a_server(bringup: Path) -> None:
    bringup.write_text(SERVER)
    session, _ = imported(bringup, name="robot1", server_port=13001, use_encryption=False)
    assert session == Session(
        name="robot1", role="server", server_ip="192.168.10.250", server_port=13001, use_encryption=False
    )
    with pytest.raises(SessionError, match="server_port: "):
        imported(bringup, name="robot1", key_file="key.txt")


def test_bluetooth_leaves_out_what_rfcomm_does(bringup: Path) -> None:
    bringup.write_text(BLUETOOTH)
    session, notes = imported(bringup, name="robot1", key_file="key.txt")
    assert session.is_bluetooth
    assert [(topic.topic, topic.port) for topic in session.topics] == [("/scan", None), ("/goal_pose", 14)]
    assert notes == [BringupNote.NOT_A_CHANNEL(name="/scan", port=12001), BringupNote.SHUTDOWN_LEFT_OUT()]


def test_what_changed_is_said(bringup: Path) -> None:
    bringup.write_text(CLIENT + "    use_sim_time: true\n")
    _, notes = imported(bringup, name="robot1", key_file="key.txt", use_name=True)
    assert notes == [BringupNote.NOT_A_PARAMETER(key="use_sim_time"), BringupNote.PREFIX(name="robot1")]


@pytest.mark.parametrize(
    ("old", "new", "line", "location", "code", "parameters"),
    [
        ("'TCP', 'UDP', 'TCP'", "'TCP', 'TPC', 'TCP'",
         15, "transmit_protocols[1]", ValueMistake.MISFIT, {"value": "'tpc'"}),
        ("[12002, 12012]", "[12002]",
         8, "receive_ports", BringupMistake.LENGTHS_DIFFER, {"count": 1, "topics": 2, "list": "receive_topics"}),
        ("[12002, 12012]", "12002", 8, "receive_ports", BringupMistake.NOT_A_LIST, {"value": 12002}),
        ("'10'", "'qos_sensor'", 10, "receive_qos[1]", QosProblem.UNKNOWN_NAME, {"value": "qos_sensor"}),
        ("'Odometry'", "'Odometri'",
         13, "transmit_msg_types[1]", TypeNameProblem.SHORT_NAME_MISSPELT, {"name": "Odometri"}),
        ("'goal_pose'", "'goal-pose'", 6, "receive_topics[1]", NameMistake.NOT_ABSOLUTE, {"name": "'/goal-pose'"}),
        ("12006", "12004", 14, "transmit_ports[2]", SessionMistake.PORT_TAKEN, {"protocol": "tcp", "port": 12004}),
        ("'192.168.10.250'", "'192.168.10'",
         3, "server_ip", SessionMistake.ADDRESS_INVALID, {"address": "'192.168.10'"}),
        ("ros__parameters", "parameters", None, None, ImportMistake.UNKNOWN, {}),
        (CLIENT,
         "client_node:\n  ros__parameters:\n    server_ip: '10.0.0.1'\n    server_port: 3000\n    topics: [scan]\n",
         2, "", BringupMistake.NO_TOPICS, {}),
        (CLIENT, "- a list\n", None, None, ImportMistake.UNKNOWN, {}),
        (CLIENT, CLIENT + SERVER,
         None, None, BringupMistake.SEVERAL_NODES, {"count": 2, "nodes": "client_node, server_node"}),
    ],
)  # fmt: skip
def test_mistakes_are_placed_in_the_thesis_file(
    bringup: Path, old: str, new: str, line: int | None, location: str | None, code: Wording, parameters: dict[str, Any]
) -> None:
    bringup.write_text(CLIENT.replace(old, new))
    with pytest.raises(SessionError) as caught:
        imported(bringup, name="robot1", key_file="key.txt")
    (problem,) = caught.value.problems
    assert problem.line == line
    assert problem.location == ("" if location is None else f"client_node.ros__parameters.{location}".rstrip("."))
    assert says(problem.message, code, **parameters)


def test_mistakes_of_the_arguments_have_no_line(bringup: Path) -> None:
    with pytest.raises(SessionError) as caught:
        imported(bringup, name="robot1", server_port=0)
    assert {(problem.location, problem.line) for problem in caught.value.problems} == {
        ("client_node.ros__parameters.server_port", 4),
        ("key_file", None),
    }
