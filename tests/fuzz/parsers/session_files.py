"""Session files, files of other bridges, and keys: what an operator wrote, or was sent by mail."""

from __future__ import annotations

from pathlib import Path

import msgspec
from tests.fuzz.editing import edit_text
from tests.fuzz.parser import Parser
from tests.fuzz.scratch import scratch_folder

from rsb_bridge.config.imports.importing import import_file
from rsb_bridge.config.imports.other_bridges import Choices
from rsb_bridge.config.keys import KEY_BYTES, KeyFileError, generate, is_key, is_key_file, read_key
from rsb_bridge.config.session_file import (
    SessionError,
    SessionFile,
    UneditableError,
    dump,
    edited_text,
    load_file,
    parse,
    same,
)
from rsb_bridge.model.session import Session, Topic

_CONFIGS = Path(__file__).parents[3] / "configs"
_KEY = generate()


def _file(data: bytes) -> Path:
    path = scratch_folder() / "robot1.yaml"
    path.write_bytes(data)
    return path


def _check_problems(error: SessionError) -> None:
    assert error.problems
    for problem in error.problems:
        assert problem.message
        assert len(problem.message) <= 2000, "a problem quotes without end"
        assert problem.line is None or problem.line >= 1


def _check_session(session: Session, path: Path) -> None:
    assert same(parse(dump(session), path), session)


def _read_session(data: bytes) -> None:
    """Check that a session that is read can be written, and edited in place."""
    path = _file(data)
    try:
        opened = load_file(path)
    except SessionError as error:
        _check_problems(error)
        return
    _check_session(opened.session, path)
    _edit(opened)


def _edit(opened: SessionFile) -> None:
    session = opened.session
    if session.role != "client":
        return
    topics = (*session.topics[1:], Topic("/fuzzed_topic", "transmit"))
    try:
        edited_text(msgspec.structs.replace(session, topics=topics), opened.path, opened)
    except UneditableError:
        pass  # reported to the operator, who may write the whole file again
    except SessionError as error:
        _check_problems(error)


def _read_foreign(data: bytes) -> None:
    path = _file(data)
    for role in (None, "server"):
        choices = Choices("robot1", role=role, key_file="robot1.key", server_port="7060")
        try:
            sessions, notes, _ = import_file(path, choices)
        except SessionError as error:
            _check_problems(error)
        else:
            assert sessions
            for session in sessions.values():
                _check_session(session, path)
                assert same(parse(dump(session, notes), path), session)
            assert all(len(note) <= 2000 for note in notes)


def _read_key(data: bytes) -> None:
    try:
        key = read_key(_file(data))
    except KeyFileError as error:
        problem = str(error)
    else:
        assert len(key.secret) == KEY_BYTES
        problem = repr(key)
    assert not any(is_key(word) for word in problem.split()), "a message gives a key away"
    text = data.decode(errors="replace")
    assert not is_key(text) or is_key_file(text)


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
        "session_file", _read_session, tuple(path.read_bytes() for path in sorted(_CONFIGS.glob("*.yaml"))), edit_text
    ),
    Parser(
        "foreign_file",
        _read_foreign,
        (_THESIS, b"server_node:\n  ros__parameters:\n    server_ip: 0.0.0.0\n", _DOMAIN_BRIDGE, _ZENOH_BRIDGE),
        edit_text,
    ),
    Parser("key_file", _read_key, (_KEY, b"2021-03-04 12:00:00\n" + _KEY + b"\n", _KEY[:-1])),
)
