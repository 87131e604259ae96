"""Import a configuration of domain_bridge (ros2/domain_bridge, 0.5 to 0.6): topics from one ROS domain to another.

One of its processes joins all domains. Here each pair of domains is a link between two processes of this machine: the
client is in the domain that the file has as ``from_domain`` first, the server in the other one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from rsb_bridge.config.decoding import join, show
from rsb_bridge.config.validation import build
from rsb_bridge.config.yaml_text import Document, SessionError, scalar
from rsb_bridge.feature_api import Wording
from rsb_bridge.model.limits import DEFAULT_PORT
from rsb_bridge.model.names import well_formed
from rsb_bridge.model.qos import TIMES
from rsb_bridge.model.session import Problem
from rsb_extras.imports.other_bridges import Choices, Imported

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_bridge.feature_api import Session

_KNOWN = {"name", "from_domain", "to_domain", "mode", "topics"}
_OF_A_TOPIC = {"type", "from_domain", "to_domain", "remap", "qos", "bidirectional", "reversed"}
_NS = 1e-9
_NAMED_POLICIES = ("reliability", "durability", "history", "depth", "liveliness")


class DomainBridgeMistake(Wording):
    """The reason why a configuration of domain_bridge cannot be imported."""

    NO_TOPICS = "no topics: give one below topics"
    NOT_A_MAPPING = "{value} is not a mapping"
    NO_DOMAIN = "missing, and the file has no default for it"
    NOT_A_DOMAIN = "{value} is not a ROS domain"
    SAME_DOMAIN = "both ends are in domain {domain}"
    TWICE = "{topic} goes from domain {source} to domain {target} twice: keep one"


class DomainBridgeNote(Wording):
    """A difference between the imported sessions and domain_bridge."""

    LEFT_OUT = "{where}: left out, because a session has no such key"
    POLICY_LEFT_OUT = "{topic}: qos {policies} left out: `qos: auto` follows the publishers"
    POLICY_ASSUMED = "{topic}: qos {policy} is {value}; domain_bridge takes the publishers' own"
    AUTO_TIME = "{topic}: qos {policy}: auto left out, because other policies are given: write its seconds"
    COMPRESSES = (
        "mode: {mode}: left out. compression: zstd compresses between the bridges, and nodes see the topic's own type"
    )


class _Entry(NamedTuple):
    """A topic of the file; a name may be there several times."""

    name: str
    location: str
    line: int
    keys: dict[str, Any]


def import_domain_bridge(document: Document, path: Path, choices: Choices) -> Imported:
    """Make two sessions for each pair of domains.

    Raises:
        SessionError: it makes no valid sessions; locations and lines are the file's.
    """
    conversion = _Conversion(document, path, choices)
    conversion.convert()
    return Imported(conversion.sessions, conversion.notes, tuple(conversion.new_keys))


class _Conversion:
    """Turns the file's topics into links, and the links into sessions."""

    def __init__(self, document: Document, path: Path, choices: Choices) -> None:
        self.sessions: dict[str, Session] = {}
        self.notes: list[str] = []
        self.new_keys: list[str] = []
        self._document = document
        self._path = path
        self._choices = choices
        self._problems: list[Problem] = []
        self._links: dict[tuple[int, int], dict[tuple[str, str], tuple[_Entry, dict[str, Any]]]] = {}

    def convert(self) -> None:
        data = self._document.data
        self.notes += [DomainBridgeNote.LEFT_OUT(where=key) for key in data if key not in _KNOWN]
        compresses = data.get("mode") in ("compress", "decompress")
        if compresses:
            self.notes.append(DomainBridgeNote.COMPRESSES(mode=data["mode"]))
        entries = _entries(self._document.root)
        if not entries:
            self._problems.append(
                Problem("topics", DomainBridgeMistake.NO_TOPICS(), self._document.lines.get("topics"))
            )
        for entry in entries:
            self._add(entry, {"compression": "zstd"} if compresses else {})
        # A topic may be listed twice: what this says of YAML's duplicate keys is no mistake in these files.
        others = [each for each in self._document.problems if not each.location.startswith("topics.")]
        if self._problems or others:
            raise SessionError(self._path, [*others, *self._problems])
        name = well_formed(self._choices.name or str(data.get("name") or self._path.stem)) or "bridge"
        for number, (domains, topics) in enumerate(self._links.items()):
            link = name if len(self._links) == 1 else f"{name}_{domains[0]}_{domains[1]}"
            port = self._choices.server_port or DEFAULT_PORT
            self._make(link, domains, port + number if isinstance(port, int) else port, topics)

    def _add(self, entry: _Entry, settings: dict[str, Any]) -> None:
        """Add a topic to the link between its domains."""
        if not isinstance(entry.keys, dict):
            self._refuse(entry, "", DomainBridgeMistake.NOT_A_MAPPING(value=show(entry.keys)))
            return
        source, target = (self._domain(entry, key) for key in ("from_domain", "to_domain"))
        if source is None or target is None:
            return
        if source == target:
            self._refuse(entry, "to_domain", DomainBridgeMistake.SAME_DOMAIN(domain=source))
            return
        if entry.keys.get("reversed") is True:
            source, target = target, source
        self.notes += [
            DomainBridgeNote.LEFT_OUT(where=f"{entry.name}: {key}") for key in entry.keys if key not in _OF_A_TOPIC
        ]
        settings |= {"type": entry.keys.get("type", "auto")} | self._qos(entry)
        there = str(entry.keys.get("remap") or entry.name)
        self._route(entry, source, target, there, settings)
        if entry.keys.get("bidirectional") is True:
            self._route(entry, target, source, there, settings)

    def _route(self, entry: _Entry, source: int, target: int, there: str, settings: dict[str, Any]) -> None:
        """Add one direction: a topic of the source is called `there` in the target's domain."""
        domains = (target, source) if (target, source) in self._links else (source, target)
        topics = self._links.setdefault(domains, {})
        sends = domains[0] == source
        here, there = _absolute(entry.name), _absolute(there)
        client, server = (here, there) if sends else (there, here)
        topic = {"topic": client, "direction": "transmit" if sends else "receive"} | settings
        if server != client:
            topic["remote_topic"] = server
        key = (client, str(topic["direction"]))
        if key in topics:
            message = DomainBridgeMistake.TWICE(topic=here, source=source, target=target)
            self._refuse(entry, "", message)
        topics[key] = (entry, topic)

    def _domain(self, entry: _Entry, key: str) -> int | None:
        value = entry.keys.get(key, self._document.data.get(key))
        if isinstance(value, int) and not isinstance(value, bool):
            return value
        missing = DomainBridgeMistake.NO_DOMAIN()
        self._refuse(entry, key, missing if value is None else DomainBridgeMistake.NOT_A_DOMAIN(value=show(value)))
        return None

    def _qos(self, entry: _Entry) -> dict[str, Any]:
        """Return the entry's `qos`, if it sets a policy of its own: what it leaves out follows the publishers there."""
        given = entry.keys.get("qos")
        if given is None:
            return {}
        if not isinstance(given, dict):
            self._refuse(entry, "qos", DomainBridgeMistake.NOT_A_MAPPING(value=show(given)))
            return {}
        if not given.keys() & {"reliability", "durability"}:
            policies = ", ".join(key for key in given if given[key] != "auto")
            if policies:
                self.notes.append(DomainBridgeNote.POLICY_LEFT_OUT(topic=entry.name, policies=policies))
            return {}
        qos = {key: given[key] for key in _NAMED_POLICIES if key in given}
        for policy, value in (("reliability", "reliable"), ("durability", "volatile")):
            if policy not in given:
                self.notes.append(DomainBridgeNote.POLICY_ASSUMED(topic=entry.name, policy=policy, value=value))
        for policy in TIMES:
            nanoseconds = given.get(policy)
            if nanoseconds == "auto":
                self.notes.append(DomainBridgeNote.AUTO_TIME(topic=entry.name, policy=policy))
            elif isinstance(nanoseconds, int) and nanoseconds > 0:  # any other means none
                qos[policy] = nanoseconds * _NS
        unknown = given.keys() - {*_NAMED_POLICIES, *TIMES}
        self.notes += [DomainBridgeNote.LEFT_OUT(where=f"{entry.name}: qos {key}") for key in sorted(unknown)]
        return {"qos": qos}

    def _make(
        self,
        link: str,
        domains: tuple[int, int],
        port: int | str,
        topics: dict[tuple[str, str], tuple[_Entry, dict[str, Any]]],
    ) -> None:
        """Make the two sessions of a link."""
        common: dict[str, Any] = {"name": link, "server_ip": "127.0.0.1", "server_port": port}
        if not self._choices.use_encryption:
            common["use_encryption"] = False
        elif self._choices.key_file:
            common["key_file"] = self._choices.key_file
        else:
            common["key_file"] = f"{link}.key"
            self.new_keys.append(common["key_file"])
        entries = [entry for entry, _ in topics.values()]
        client = {"role": "client", "domain_id": domains[0], "topics": [topic for _, topic in topics.values()]}
        for domain, role in ((domains[0], client), (domains[1], {"role": "server", "domain_id": domains[1]})):
            self.sessions[f"{link}-domain{domain}"], problems = build(common | role)
            if problems:
                raise SessionError(self._path, [self._located(problem, entries) for problem in problems])

    def _refuse(self, entry: _Entry, key: str, message: str) -> None:
        location = join(entry.location, key) if key else entry.location
        line = self._document.lines.get(location, entry.line) if key else entry.line  # a name may be there twice
        self._problems.append(Problem(location, message, line))

    def _located(self, problem: Problem, entries: list[_Entry]) -> Problem:
        """Give a problem of a session the place of its topic in the file."""
        for at, entry in enumerate(entries):
            here = join("topics", at)
            if problem.location == here or problem.location.startswith((f"{here}.", f"{here}[")):
                return Problem(entry.location + problem.location[len(here) :], problem.message, entry.line)
        return problem


def _entries(root: yaml.Node) -> list[_Entry]:
    """Return the topics in order; the plain data has only the first of those with the same name."""
    found = []
    topics = [value for key, value in root.value if key.value == "topics"] if isinstance(root, yaml.MappingNode) else []
    for key, value in topics[0].value if topics and isinstance(topics[0], yaml.MappingNode) else ():
        found.append(_Entry(str(key.value), join("topics", str(key.value)), key.start_mark.line + 1, _plain(value)))
    return found


def _plain(node: yaml.Node) -> Any:
    if isinstance(node, yaml.MappingNode):
        return {str(key.value): _plain(value) for key, value in node.value}
    if isinstance(node, yaml.SequenceNode):
        return [_plain(each) for each in node.value]
    return scalar(node)


def _absolute(name: str) -> str:
    """Return a topic's full name: domain_bridge's own nodes are in no namespace."""
    return name if name.startswith("/") else f"/{name}"
