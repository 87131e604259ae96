"""Import a configuration of zenoh-bridge-ros2dds (eclipse-zenoh/zenoh-plugin-ros2dds, 1.10: its DEFAULT_CONFIG.json5).

Each of its bridges routes what its own ``allow`` or ``deny`` admits, on both ends. Here the client lists the topics,
and the server's list becomes the client's rights. Both sides are linked over TCP: no router is needed between two.
"""

from __future__ import annotations

import fnmatch
from typing import TYPE_CHECKING, Any

from rsb_bridge.config.decoding import show
from rsb_bridge.config.validation import build
from rsb_bridge.config.yaml_text import SessionError
from rsb_bridge.feature_api import Wording
from rsb_bridge.model.limits import DEFAULT_PORT
from rsb_bridge.model.names import well_formed
from rsb_bridge.model.patterns import Pattern, is_pattern
from rsb_bridge.model.session import Problem
from rsb_extras.imports.name_expressions import globs, patterns
from rsb_extras.imports.other_bridges import ZENOH_PLUGIN, Choices, Imported

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_INTERFACES = ("publishers", "subscribers", "service_servers", "service_clients", "action_servers", "action_clients")
_HANDLED = {"namespace", "domain", "allow", "deny", "pub_max_frequencies", "pub_priorities", "queries_timeout"}
_OF_THE_FILE = {"plugins", "mode", "connect", "listen"}
_ALL = "/**"
_EVERYTHING = "*"
_HIGHEST_NORMAL, _LOWEST_NORMAL = 4, 5  # of Zenoh's 1 to 7; 5 is its default


class ZenohBridgeMistake(Wording):
    """The reason why a configuration of zenoh-bridge-ros2dds cannot be imported."""

    BOTH_LISTS = "allow and deny: zenoh-bridge-ros2dds takes only one of them"
    NOT_A_MAPPING = "{value} is not a mapping"
    NOT_A_LIST = "{value} is not a list of texts"
    NOT_A_SETTING = "{value} is not EXPRESSION=NUMBER"


class ZenohBridgeNote(Wording):
    """A difference between the imported session and zenoh-bridge-ros2dds."""

    LEFT_OUT = "{key}: left out, because a session has no such key"
    EXPRESSION = "{key}: {expression} left out: write the names that it means, by hand, as patterns with * and **"
    NO_ENTRY = "{key}: {expression} left out: no entry has just these names; set it on theirs"
    NAMESPACE_OF_SERVER = "namespace {namespace}: left out: a server's own names have no prefix; set remote_topic"
    NAMESPACE_AS_NAME = "namespace {namespace}: use_name puts it before this side's names on the server, not in reply"
    ADDRESS = "connect {endpoint}: the link goes to port {port} over TCP, with this bridge on both sides"
    FURTHER = "connect {endpoint}: left out: a client has one server"
    LISTENS = "listen {endpoint}: the server takes port {port} on all addresses"
    ALL_NAMES = "{name} bridges at most 100 names: list important ones by name"
    NOTHING_ALLOWED = "allow: it names nothing that can be written: all is denied; correct deny, and add allow"
    SERVER_PRIORITY = "pub_priorities: left out: set priority in the client's entries"
    TIMEOUTS = "queries_timeout: only a number of seconds for services is carried over"
    EXPRESS = "pub_priorities: express left out: messages are sent at once where the link is free"


def import_zenoh_bridge(data: dict[str, Any], path: Path, choices: Choices) -> Imported:
    """Make the session of one side.

    Raises:
        SessionError: it makes no valid session.
    """
    conversion = _Conversion(data, path, choices)
    session, problems = build(conversion.session())
    if problems or conversion.problems:
        raise SessionError(path, conversion.problems or problems)
    return Imported({"": session}, conversion.notes)


class _Conversion:
    """Turns the plugin's settings into a session, as plain data."""

    def __init__(self, data: dict[str, Any], path: Path, choices: Choices) -> None:
        self.notes: list[str] = []
        self.problems: list[Problem] = []
        self._path = path
        self._choices = choices
        self._file = data
        plugin = data["plugins"][ZENOH_PLUGIN]
        self._plugin: dict[str, Any] = self._mapping(f"plugins.{ZENOH_PLUGIN}", plugin)
        self._connect = self._endpoints("connect")
        self._role = choices.role or ("client" if self._connect else "server")

    def session(self) -> dict[str, Any]:
        plugin = self._plugin
        left_out = [key for key in self._file if key not in _OF_THE_FILE]
        left_out += [f"plugins.{key}" for key in self._file["plugins"] if key != ZENOH_PLUGIN]
        left_out += [key for key in plugin if key not in _HANDLED]
        self.notes += [ZenohBridgeNote.LEFT_OUT(key=key) for key in left_out]
        if plugin.get("allow") and plugin.get("deny"):
            self._refuse("allow", ZenohBridgeMistake.BOTH_LISTS())
        session: dict[str, Any] = self._address()
        domain = self._choices.domain_id if self._choices.domain_id is not None else plugin.get("domain")
        if domain is not None:
            session["domain_id"] = domain
        if not self._choices.use_encryption:
            session["use_encryption"] = False
        elif self._choices.key_file:
            session["key_file"] = self._choices.key_file
        return session | (self._client_lists() if self._role == "client" else self._server_lists(session))

    def _address(self) -> dict[str, Any]:
        """Return who this side is, and where the server is."""
        namespace = str(self._plugin.get("namespace", "/")).strip("/")
        name = self._choices.name or well_formed(namespace) or well_formed(self._path.stem) or "robot1"
        use_name = self._choices.use_name
        port = self._choices.server_port or DEFAULT_PORT
        if namespace and self._role == "client":
            use_name = True
            self.notes.append(ZenohBridgeNote.NAMESPACE_AS_NAME(namespace=f"/{namespace}"))
        elif namespace:
            self.notes.append(ZenohBridgeNote.NAMESPACE_OF_SERVER(namespace=f"/{namespace}"))
        first, *others = self._connect or [""]
        if self._role == "client" and first:
            self.notes.append(ZenohBridgeNote.ADDRESS(endpoint=first, port=port))
        self.notes += [ZenohBridgeNote.FURTHER(endpoint=each) for each in others]
        if self._role == "server":
            listens = self._endpoints("listen")
            self.notes += [ZenohBridgeNote.LISTENS(endpoint=each, port=port) for each in listens]
        host = first.partition("/")[2].rpartition(":")[0].strip("[]")
        found = {"name": name, "role": self._role, "server_port": port}
        # Without an endpoint it scouts; the address is then asked for like any key that is missing.
        if self._role == "server" or host:
            found["server_ip"] = host if self._role == "client" else "0.0.0.0"  # noqa: S104 -- as it listens by default
        return found | ({"use_name": True} if use_name else {})

    def _client_lists(self) -> dict[str, Any]:
        lists: dict[str, Any] = {"topics": [], "services": [], "actions": []}
        timeout = self._service_timeout()
        for interface in _INTERFACES:
            allowed, denied = self._names(interface, patterns, _ALL)
            kind = "topic" if interface in ("publishers", "subscribers") else interface.partition("_")[0]
            sends = interface in ("publishers", "service_clients", "action_clients")
            entries = {name: dict[str, Any]() for name in allowed}
            if interface == "publishers":
                entries = self._with_settings(entries)
            for name, settings in entries.items():
                if kind == "topic":
                    entry: dict[str, Any] = {"topic": name, "direction": "transmit" if sends else "receive"}
                else:
                    entry = {kind: name, "provider": "server" if sends else "client"}
                    entry |= {"timeout": timeout} if timeout and kind == "service" else {}
                if denied and is_pattern(name):
                    entry["except"] = denied
                lists[f"{kind}s"].append(entry | settings)
            if _ALL in allowed:
                self.notes.append(ZenohBridgeNote.ALL_NAMES(name=f"{interface} {_ALL}"))
        return {key: value for key, value in lists.items() if value}

    def _server_lists(self, session: dict[str, Any]) -> dict[str, Any]:
        """Return the one client, with this side's list as its rights."""
        rights: dict[str, list[dict[str, Any]]] = {"allow": [], "deny": []}
        may = ("read", "publish", "call", "serve", "call", "serve")
        listed = self._plugin.keys() & {"allow", "deny"}
        for interface, right in zip(_INTERFACES, may, strict=True):
            allowed, denied = self._names(interface, globs, _EVERYTHING)
            key = "topics" if right in ("read", "publish") else "services"
            entries = allowed if "allow" in listed else denied if "deny" in listed else []
            rights["deny" if "deny" in listed else "allow"] += [{key: name, "may": right} for name in entries]
        unique: dict[str, list[Any]] = {
            key: [dict(each) for each in dict.fromkeys(tuple(entry.items()) for entry in entries)]
            for key, entries in rights.items()
        }
        for name, rate in self._settings("pub_max_frequencies", globs):
            # A right of its own may only narrow one that is there: it would allow what no list does.
            read = [each for each in unique["allow"] if each["may"] == "read"]
            if alike := [each for each in read if fnmatch.fnmatchcase(each["topics"], name)]:
                for each in alike:
                    each.setdefault("max_rate", rate)
            elif any(fnmatch.fnmatchcase(name, each["topics"]) for each in read):
                unique["allow"].append({"topics": name, "may": "read", "max_rate": rate})
            else:
                self.notes.append(ZenohBridgeNote.NO_ENTRY(key="pub_max_frequencies", expression=name))
        if "allow" in listed and not unique["allow"]:  # a client without rights here may do everything
            unique["deny"] = [_EVERYTHING]
            self.notes.append(ZenohBridgeNote.NOTHING_ALLOWED())
        if self._plugin.get("pub_priorities"):
            self.notes.append(ZenohBridgeNote.SERVER_PRIORITY())
        client = {"name": session["name"]} | {key: value for key, value in unique.items() if value}
        return {"clients": [client]}

    def _names(
        self, interface: str, convert: Callable[[str], list[str] | None], everything: str
    ) -> tuple[list[str], list[str]]:
        """Return what is allowed and what is denied of an interface."""
        allow, deny = self._plugin.get("allow"), self._plugin.get("deny")
        if allow is not None:
            return self._converted(f"allow.{interface}", self._mapping("allow", allow).get(interface, []), convert), []
        denied = [] if deny is None else self._mapping("deny", deny).get(interface, [])
        return [everything], self._converted(f"deny.{interface}", denied, convert)

    def _converted(self, key: str, expressions: object, convert: Callable[[str], list[str] | None]) -> list[str]:
        found: list[str] = []
        if not isinstance(expressions, list) or not all(isinstance(each, str) for each in expressions):
            self._refuse(key, ZenohBridgeMistake.NOT_A_LIST(value=show(expressions)))
            return found
        for expression in expressions:
            names = convert(expression)
            if names is None:
                self.notes.append(ZenohBridgeNote.EXPRESSION(key=key, expression=expression))
            found += names or []
        return list(dict.fromkeys(found))

    def _settings(self, key: str, convert: Callable[[str], list[str] | None] = patterns) -> list[tuple[str, float]]:
        """Return the numbers of a list of ``EXPRESSION=NUMBER``, by name or pattern; earlier ones win."""
        found: dict[str, float] = {}
        listed = self._plugin.get(key, [])
        if not isinstance(listed, list):
            self._refuse(key, ZenohBridgeMistake.NOT_A_LIST(value=show(listed)))
            return []
        for each in listed:
            expression, _, number = str(each).rpartition("=")
            number, _, option = number.partition(":")
            try:
                value = float(number)
            except ValueError:
                self._refuse(key, ZenohBridgeMistake.NOT_A_SETTING(value=show(each)))
                continue
            if option:
                self.notes.append(ZenohBridgeNote.EXPRESS())
            for name in self._converted(key, [expression], convert):
                found.setdefault(name, value)
        return list(found.items())

    def _with_settings(self, entries: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        """Give the entries of publishers their rates and priorities, and names of these an entry of their own."""
        rates, levels = self._settings("pub_max_frequencies"), self._settings("pub_priorities")
        rules = [("pub_max_frequencies", name, {"max_rate": rate}) for name, rate in rates]
        rules += [("pub_priorities", name, _priority(level)) for name, level in levels]
        own: dict[str, dict[str, Any]] = {}
        for key, name, _ in rules:
            if name not in entries and any(each == _ALL or _covers(each, name) for each in entries):
                own[name] = {}  # before the pattern that it is part of: the first one wins
            elif not any(_covers(name, each) for each in entries):
                self.notes.append(ZenohBridgeNote.NO_ENTRY(key=key, expression=name))
        found = own | entries
        for _, rule, values in reversed(rules):  # the first one that applies wins
            for name in found:
                if _covers(rule, name):
                    found[name] = found[name] | values
        return found

    def _service_timeout(self) -> float | None:
        timeouts = self._plugin.get("queries_timeout")
        if timeouts is None:
            return None
        self.notes.append(ZenohBridgeNote.TIMEOUTS())
        timeouts = self._mapping("queries_timeout", timeouts)
        seconds = timeouts.get("services", timeouts.get("default"))
        return float(seconds) if isinstance(seconds, int | float) and not isinstance(seconds, bool) else None

    def _endpoints(self, key: str) -> list[str]:
        section = self._file.get(key)
        endpoints = section.get("endpoints") if isinstance(section, dict) else None
        if isinstance(endpoints, dict):  # by mode, as Zenoh fills them in
            endpoints = endpoints.get(str(self._file.get("mode") or "router"))
        return [str(each) for each in endpoints] if isinstance(endpoints, list) else []

    def _mapping(self, key: str, value: object) -> dict[str, Any]:
        if isinstance(value, dict):
            return value
        if value is not None:
            self._refuse(key, ZenohBridgeMistake.NOT_A_MAPPING(value=show(value)))
        return {}

    def _refuse(self, key: str, message: str) -> None:
        self.problems.append(Problem(key, message))


def _covers(pattern: str, name: str) -> bool:
    """Whether a pattern matches a whole name, or is the same pattern."""
    return pattern == name or (not is_pattern(name) and Pattern(pattern).match(name) is not None)


def _priority(level: float) -> dict[str, Any]:
    """Convert a priority of Zenoh's, 1 (highest) to 7."""
    if level < _HIGHEST_NORMAL:
        return {"priority": "high"}
    return {"priority": "low" if level > _LOWEST_NORMAL else "normal"}
