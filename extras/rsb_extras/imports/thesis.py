"""Import the thesis's configuration, ``config/bringup.yaml`` of ros2_socket_bridge (Foxy, 2021).

The file holds ROS parameters. A client's (node ``client_node``) has ``server_ip``, ``server_port`` and, for each
direction, five lists whose n-th entries belong together: ``transmit_topics``, ``transmit_msg_types``,
``transmit_ports``, ``transmit_protocols``, ``transmit_qos``, and the same with ``receive_``. A server's
(``server_node``) has only ``server_ip``. The launch file had the rest: ``-name``, ``-key``, ``-usename``, ``-encrypt``
and, for a server, ``-p``. Here they are arguments.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rsb_bridge.config.decoding import join, show
from rsb_bridge.config.validation import build
from rsb_bridge.config.yaml_text import SessionError
from rsb_bridge.feature_api import Wording
from rsb_bridge.model.limits import CHANNEL
from rsb_bridge.model.session import Direction, Problem
from rsb_bridge.model.transport_traits import is_mac
from rsb_bridge.model.type_names import SHORT_NAMES
from rsb_extras.imports.other_bridges import Choices, Imported, bridge_nodes

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_bridge.config.yaml_text import Document


class BringupMistake(Wording):
    """The reason why a thesis's configuration cannot be imported."""

    NO_TOPICS = "no topics: a client has the lists {lists}"
    SEVERAL_NODES = "{count} nodes have a server_ip: {nodes}. Keep one in the file, and import one at a time"
    NOT_A_LIST = "{value} is not a list"
    LENGTHS_DIFFER = "{count} entries for {topics} {list}: give one for each"


class BringupNote(Wording):
    """A difference between the imported session and the thesis's bridge."""

    TOPICS_LEFT_OUT = "the topics are left out: a server gets them from its clients"
    PREFIX = (
        "use_name: topics that the client receives are named /{name}/... on the server; the thesis's bridge had that "
        "prefix on the client instead"
    )
    NOT_A_PARAMETER = "{key}: left out, because it is not a parameter of the bridge"
    SHUTDOWN_LEFT_OUT = "/shutdown: left out, because shutdown_topic of the session replaces it"
    NOT_A_CHANNEL = "{name}: {port} is not an RFCOMM channel; the topic shares the link's"


_DIRECTIONS: tuple[Direction, ...] = ("transmit", "receive")
_LISTS = {"topic": "topics", "type": "msg_types", "port": "ports", "protocol": "protocols", "qos": "qos"}
# rclpy.qos of Foxy; a string of digits is a depth.
_QOS = {
    "qos_profile_default": "default",
    "qos_profile_system_default": "system_default",
    "qos_profile_sensor_data": "sensor_data",
    "qos_profile_services_default": "services_default",
    "qos_profile_parameters": "parameters",
    "qos_profile_parameter_events": "parameters",
    "qos_profile_action_status_default": "latched",
}


def import_bringup(document: Document, path: Path, choices: Choices) -> Imported:
    """Make a session of a thesis ``bringup.yaml``, of a client or a server.

    A client's file makes a server's session too, without the topics. The role is by default that of the file's node,
    ``client_node`` or ``server_node``, and the domain ``$ROS_DOMAIN_ID``.

    Raises:
        SessionError: it makes no valid session; locations and lines are the file's.
    """
    node, parameters = _bridge_node(document.data, path)
    role = choices.role or ("server" if "server" in node else "client")
    bringup = _Bringup(join(node, "ros__parameters"), parameters)
    if role == "client":
        if not any(parameters.get(f"{direction}_topics") for direction in _DIRECTIONS):
            message = BringupMistake.NO_TOPICS(lists=" and ".join(f"{each}_topics" for each in _DIRECTIONS))
            bringup.problems.append(Problem(bringup.location, message))
        bringup.add_topics()
    elif any(parameters.get(f"{direction}_topics") for direction in _DIRECTIONS):
        bringup.notes.append(BringupNote.TOPICS_LEFT_OUT())
    if choices.use_name and any(topic["direction"] == "receive" for topic in bringup.topics):
        bringup.notes.append(BringupNote.PREFIX(name=choices.name))
    data: dict[str, Any] = {key: parameters[key] for key in ("server_ip", "server_port") if key in parameters}
    given = {each: getattr(choices, each) for each in ("name", "server_port", "key_file", "domain_id")}
    data |= {key: value for key, value in given.items() if value is not None}
    data |= {"role": role, "use_name": choices.use_name, "use_encryption": choices.use_encryption}
    session, problems = build(data | {"topics": bringup.topics})
    problems = document.problems + bringup.problems + [bringup.translate(problem) for problem in problems]
    if problems:
        raise SessionError(
            path, [document.locate(each) if each.location.startswith(node) else each for each in problems]
        )
    return Imported({"": session}, bringup.notes)


def _bridge_node(data: object, path: Path) -> tuple[str, dict[str, Any]]:
    """Return the name and parameters of the only bridge node in the file."""
    nodes = bridge_nodes(data)
    if len(nodes) > 1:
        message = BringupMistake.SEVERAL_NODES(count=len(nodes), nodes=", ".join(nodes))
        raise SessionError(path, [Problem("", message)])
    return nodes.popitem()


class _Bringup:
    """Turns a node's parameters into the topics of a session.

    Attributes:
        topics: as a session file has them.
        notes: what differs from the thesis's bridge, one line each.
        problems: with the locations of the thesis's file.
        location: of the node's parameters in that file.
    """

    def __init__(self, location: str, parameters: dict[str, Any]) -> None:
        self.topics: list[dict[str, Any]] = []
        self.notes: list[str] = []
        self.problems: list[Problem] = []
        self.location = location
        self._parameters = parameters
        self._origins: dict[str, str] = {
            key: join(location, key) for key in ("server_ip", "server_port") if key in parameters
        }
        known = {"server_ip", "server_port"}
        known |= {f"{direction}_{suffix}" for direction in _DIRECTIONS for suffix in _LISTS.values()}
        self.notes += [BringupNote.NOT_A_PARAMETER(key=key) for key in parameters if key not in known]

    def add_topics(self) -> None:
        """Read the lists of both directions."""
        for direction in _DIRECTIONS:
            columns = self._columns(direction)
            for at in range(len(columns["topic"])):
                topic = {key: _modern(key, column[at]) for key, column in columns.items() if column}
                self._add(topic | {"direction": direction}, at)

    def translate(self, problem: Problem) -> Problem:
        """Give a problem of the session its location in the thesis's file, if it has one there."""
        return Problem(self._origins.get(problem.location, problem.location), problem.message)

    def _columns(self, direction: Direction) -> dict[str, list[Any]]:
        """Return one direction's lists, by the keys of a topic; all empty if they do not fit together."""
        columns = {key: self._parameters.get(f"{direction}_{suffix}") or [] for key, suffix in _LISTS.items()}
        topics = columns["topic"]
        faults = {}
        for key, column in columns.items():
            if not isinstance(column, list):
                faults[key] = BringupMistake.NOT_A_LIST(value=show(column))
            elif column and isinstance(topics, list) and len(column) != len(topics):
                faults[key] = BringupMistake.LENGTHS_DIFFER(
                    count=len(column), topics=len(topics), list=f"{direction}_topics"
                )
        self.problems += [
            Problem(join(self.location, f"{direction}_{_LISTS[key]}"), message) for key, message in faults.items()
        ]
        return columns if not faults else {key: [] for key in _LISTS}

    def _add(self, topic: dict[str, Any], at: int) -> None:
        name, port = topic["topic"], topic.get("port")
        if name == "/shutdown":
            self.notes.append(BringupNote.SHUTDOWN_LEFT_OUT())
            return
        if isinstance(port, int) and port > CHANNEL.high and is_mac(str(self._parameters["server_ip"])):
            del topic["port"]
            self.notes.append(BringupNote.NOT_A_CHANNEL(name=name, port=port))
        here = join("topics", len(self.topics))
        lists = {key: join(self.location, f"{topic['direction']}_{suffix}") for key, suffix in _LISTS.items()}
        self._origins |= {join(here, key): join(location, at) for key, location in lists.items()}
        self._origins[here] = join(lists["topic"], at)
        self.topics.append(topic)


def _modern(key: str, value: Any) -> Any:
    """Convert a list's entry to the form of session files. The validation refuses unknown values."""
    if not isinstance(value, str):
        return value
    if key == "topic" and not value.startswith(("/", "~")):
        return f"/{value}"
    if key == "type":
        return SHORT_NAMES.get(value, value)
    if key in ("port", "qos") and value.isdecimal():
        return int(value)
    if key == "qos":
        return _QOS.get(value, value)
    return value.lower() if key == "protocol" else value
