"""Files of other bridges: what somebody else wrote, or was sent by mail."""

from __future__ import annotations

from pathlib import Path

from tests.fuzz.editing import edit_text
from tests.fuzz.parser import Parser
from tests.fuzz.parsers.session_files import check_problems, check_session, file_of

from rsb_bridge.config.session_file import SessionError, dump, parse, same
from rsb_extras.imports.importing import import_file
from rsb_extras.imports.other_bridges import Choices


def _read_foreign(data: bytes) -> None:
    path = file_of(data)
    for role in (None, "server"):
        choices = Choices("robot1", role=role, key_file="robot1.key", server_port="7060")
        try:
            sessions, notes, _ = import_file(path, choices)
        except SessionError as error:
            check_problems(error)
        else:
            assert sessions
            for session in sessions.values():
                check_session(session, path)
                assert same(parse(dump(session, notes), path), session)
            assert all(len(note) <= 2000 for note in notes)


_THESIS = b"""client_node:
  ros__parameters:
    server_ip: 192.168.1.10
    server_port: 12000
    transmit_topics: [scan, /map]
    transmit_msg_types: [LaserScan, OccupancyGrid]
    transmit_ports: ["12001", "12002"]
    transmit_protocols: [UDP, TCP]
    transmit_qos: [qos_profile_sensor_data, "10"]
    receive_topics: [cmd_vel]
    receive_msg_types: [Twist]
    receive_ports: ["12003"]
    receive_protocols: [TCP]
    receive_qos: [qos_profile_default]
"""

_DOMAIN_BRIDGE = b"""name: hall
from_domain: 2
to_domain: 3
topics:
  scan: {type: sensor_msgs/msg/LaserScan, qos: {reliability: best_effort, depth: 5}}
  scan: {type: sensor_msgs/msg/LaserScan, to_domain: 4, remap: /hall/scan}
  goal_pose: {type: geometry_msgs/msg/PoseStamped, reversed: True}
"""
_ZENOH_BRIDGE = b"""plugins:
  ros2dds:
    namespace: /robot1
    domain: 2
    allow: {publishers: [".*/scan", "/(map|tf)"], subscribers: ["/cmd_vel"], service_servers: [".*"]}
    pub_max_frequencies: [".*/scan=5"]
    pub_priorities: ["/map=7", "/tf=1:express"]
connect: {endpoints: [tcp/192.168.1.10:7447]}
"""

PARSERS = (
    Parser(
        "foreign_file",
        _read_foreign,
        (_THESIS, b"server_node:\n  ros__parameters:\n    server_ip: 0.0.0.0\n", _DOMAIN_BRIDGE, _ZENOH_BRIDGE),
        edit_text,
        Path(__file__).with_name("corpus"),
    ),
)
