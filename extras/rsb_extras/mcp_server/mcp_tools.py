"""The tools that a program is offered: each is a command of this program with ``--json``, and what is shown of it.

So a program has exactly what its user's shell has. What moves something has no tool.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from rsb_bridge.feature_api import Wording, escape_text
from rsb_bridge.model.motion import may_move
from rsb_bridge.model.patterns import is_pattern

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    Arguments = Mapping[str, Any]

_MOST_ITEMS, _MOST_CHARACTERS, _DEEPEST = 200, 2000, 16
"""Elements of a list, characters of a text and levels of an answer. Round figures: a program reads it all."""
_MOST_VALUES, _SHORT = 5000, 20
"""Values of an answer, after which the rest is left out, and characters of one; a longer one counts as several."""
_OMITTED = "left_out"


class ToolProblem(Wording):
    """The reason why a tool does nothing."""

    NO_TOOL = "there is no tool {name}: tools/list names those that are offered"
    UNKNOWN = "unknown arguments: {names}"
    MISSING = "{name} is missing"
    INVALID = "{name} is invalid: {about}"
    MOVES = "{topic} may move a robot: add or resume it in the console, or in a shell"
    UNKNOWN_TYPE = (
        "the type of {topic} is not known yet, and it may move a robot: resume it in the console, or in a shell"
    )
    PATTERN = "{topic} is a pattern, which may match what moves a robot: name one topic"


class ToolError(ValueError):
    """A tool's arguments are wrong, or it is not for them; the text has the remedy."""


@dataclass(frozen=True)
class Argument:
    """An argument of a tool.

    Attributes:
        pattern: a regular expression of the whole text, or an empty string for a switch.
        about: for the program, with an example.
    """

    name: str
    pattern: str
    about: str
    required: bool = False

    @property
    def schema(self) -> dict[str, Any]:
        if not self.pattern:
            return {"type": "boolean", "description": self.about}
        return {"type": "string", "pattern": f"^{self.pattern}$", "description": self.about}

    def check(self, value: Any) -> None:
        """Raise `ToolError` if a value is none."""
        fits = isinstance(value, str) and re.fullmatch(self.pattern, value) if self.pattern else isinstance(value, bool)
        if not fits:
            raise ToolError(ToolProblem.INVALID(name=self.name, about=self.about))


@dataclass(frozen=True)
class OfferedTool:
    """A tool.

    Attributes:
        words: the command of its arguments, without those that name the bridge.
        show: what is shown of the command's object.
        before: looks at the topic, as `info` shows it, before the command is run; it may raise `ToolError`.
        lines: whether the command prints an object a line, the last of which are shown.
    """

    name: str
    about: str
    words: Callable[[Arguments], list[str]]
    arguments: tuple[Argument, ...] = ()
    show: Callable[[Any, Arguments], Any] = lambda found, _: found
    before: Callable[[Any], None] | None = None
    changes: bool = False
    lines: bool = False

    @property
    def schema(self) -> dict[str, Any]:
        return {
            "type": "object",
            "properties": {each.name: each.schema for each in self.arguments},
            "required": [each.name for each in self.arguments if each.required],
            "additionalProperties": False,
        }

    def check(self, given: Arguments) -> None:
        """Raise `ToolError` unless the tool has all of these arguments, and they have what it needs."""
        known = {each.name: each for each in self.arguments}
        if unknown := given.keys() - known.keys():
            raise ToolError(ToolProblem.UNKNOWN(names=", ".join(sorted(map(escape_text, unknown)))[:200]))
        for each in self.arguments:
            if each.name in given:
                each.check(given[each.name])
            elif each.required:
                raise ToolError(ToolProblem.MISSING(name=each.name))


_NAME = r"/[A-Za-z0-9_/~*]{1,254}"
_LINK_NAME = r"(?!-)[^\x00-\x1f\x7f-\x9f\ud800-\udfff]{1,255}"
"""A name that an operator may give a client, unless the command would take it for an option."""
_TOPIC = Argument("topic", _NAME, "its name on the bridge's side: /scan", required=True)
_LINK = Argument("link", _LINK_NAME, "the link, if several have it; status names them")
_WHICH = (_TOPIC, _LINK)
_TYPE = r"[A-Za-z0-9_]{1,100}/msg/[A-Za-z0-9]{1,100}"
_WAYS = "transmit: client to server; receive: server to client"
_NEW = (
    Argument("topic", _NAME, "its name on the client: /scan", required=True),
    Argument("direction", "transmit|receive", _WAYS, required=True),
    Argument("type", _TYPE, "sensor_msgs/msg/LaserScan", required=True),
    Argument("remote_topic", _NAME, "its name on the server, if another"),
    Argument("max_rate", r"[0-9]{1,6}(\.[0-9]{1,3})?", "Hz at most"),
    _LINK,
)


def _route(command: str, *more: str) -> Callable[[Arguments], list[str]]:
    return lambda given: [command, given["topic"], *_of_link(given), *more]


def _of_link(given: Arguments) -> list[str]:
    return [f"--link={given['link']}"] if "link" in given else []


# --- what is shown of `status`


def _status(found: Any, _: Arguments) -> Any:
    """Leave out the routes, of which there may be a thousand."""
    if "routes" not in found:
        return found  # of several bridges, or an error
    states: dict[str, int] = {}
    for route in found["routes"]:
        states[route["state"]] = states.get(route["state"], 0) + 1
    return {name: value for name, value in found.items() if name != "routes"} | {"topics_by_state": states}


_WRONG = ("down", "stale", "stopped", "late", "slow", "unheard")
_VERDICT = (
    "topic",
    "kind",
    "link",
    "outgoing",
    "state",
    "cause",
    "reason",
    "from_peer",
    "since",
    "acknowledged",
    "missing",
)
_FIGURES = ("topic", "kind", "link", "outgoing", "state", "cause", "rate", "bytes_per_second", "latency_p50")


def _verdicts(found: Any, given: Arguments) -> Any:
    """Return what is wrong and why, of links and routes; with `all` also what only waits, is paused or disarmed."""
    if "routes" not in found:
        return found
    wanted = given.get("all", False)
    links = [each | {"link": name} for name, each in found["links"].items() if wanted or each["reason"]]
    routes = [
        {name: route[name] for name in _VERDICT if name in route}
        for route in found["routes"]
        if (route["state"] in _WRONG or (wanted and route["state"] != "ok")) and _is_of(route, given)
    ]
    return {"ok": found["ok"], "links": links, "topics": routes}


def _topics(found: Any, given: Arguments) -> Any:
    if "routes" not in found:
        return found
    part = given.get("part", "")
    routes = [each for each in found["routes"] if part in each["topic"] and _is_of(each, given)]
    return {"topics": [{name: each[name] for name in _FIGURES if name in each} for each in routes]}


def _is_of(route: Any, given: Arguments) -> bool:
    return "link" not in given or route["link"] == given["link"]


# --- what may change


def _still(found: Any) -> None:
    """Raise `ToolError` if a route carries what may move a robot."""
    type_name, topic = found["type"], found["topic"]
    if may_move(type_name, topic, found["remote_topic"]):
        raise ToolError(ToolProblem.MOVES(topic=escape_text(topic)))
    if not type_name:
        raise ToolError(ToolProblem.UNKNOWN_TYPE(topic=escape_text(topic)))


def _add(given: Arguments) -> list[str]:
    topic, remote = given["topic"], given.get("remote_topic", given["topic"])
    if is_pattern(topic) or is_pattern(remote):
        raise ToolError(ToolProblem.PATTERN(topic=topic))
    if may_move(given["type"], topic, remote):
        raise ToolError(ToolProblem.MOVES(topic=topic))
    values = [f"{name}={given[name]}" for name in ("type", "remote_topic", "max_rate") if name in given]
    return ["add", topic, given["direction"], *values, *_of_link(given)]


TOOLS: Final = {
    each.name: each
    for each in (
        OfferedTool(
            "status",
            "The bridge, its links, what is wrong in sentences, and how many topics are in each state.",
            lambda _: ["status"],
            show=_status,
        ),
        OfferedTool(
            "verdicts",
            "What is wrong with which link and topic, why, since when, and what to do.",
            lambda _: ["status"],
            (_LINK, Argument("all", "", "also what waits, is paused or is not armed")),
            show=_verdicts,
        ),
        OfferedTool(
            "topics",
            "The bridged topics and services with state, rate, bandwidth and latency.",
            lambda _: ["status"],
            (_LINK, Argument("part", r"[A-Za-z0-9_/]{1,64}", "a part of their names")),
            show=_topics,
        ),
        OfferedTool(
            "topic",
            "All details of one topic: type, QoS, publishers and subscribers, stages that messages pass, figures.",
            _route("info"),
            _WHICH,
        ),
        OfferedTool(
            "message",
            "A topic's latest message, decoded, with its age. Long arrays are shortened.",
            _route("echo", "--once", "--timeout=10"),
            _WHICH,
        ),
        OfferedTool(
            "nodes",
            "The ROS nodes of the other side, or of the bridge's own, with processes, lifecycle and last log lines.",
            lambda given: ["nodes", "--all", *(["--here"] if given.get("here") else _named(given))],
            (_LINK, Argument("here", "", "those of the bridge's own side")),
        ),
        OfferedTool(
            "history",
            "Outages, gaps and operators' actions of the last hours, and how links and topics were.",
            lambda given: ["report", f"--last={given.get('last', '1h')}"],
            (Argument("last", r"[0-9]{1,4}[mh]", "a span up to 24h: 30m"),),
        ),
        OfferedTool(
            "events",
            "The newest lines of the bridge's log.",
            lambda _: ["events"],
            lines=True,
        ),
        OfferedTool(
            "add_topic",
            "Bridge one more topic, until the bridge ends. What may move a robot is refused.",
            _add,
            _NEW,
            changes=True,
        ),
        OfferedTool(
            "remove_topic",
            "Stop bridging a topic, on both sides.",
            _route("remove", "--kind=topic"),
            _WHICH,
            changes=True,
        ),
        OfferedTool(
            "pause_topic",
            "Stop carrying a topic's messages, on both sides.",
            _route("pause", "--kind=topic"),
            _WHICH,
            changes=True,
        ),
        OfferedTool(
            "resume_topic",
            "Resume a paused topic. What may move a robot is refused.",
            _route("resume", "--kind=topic"),
            _WHICH,
            before=_still,
            changes=True,
        ),
    )
}
"""By name."""


def _named(given: Arguments) -> list[str]:
    return [given["link"]] if "link" in given else []


# --- answers


def bounded(value: Any) -> Any:
    """Return plain data with its texts cleaned, and what is too long or too deep left out.

    Names, reasons, log lines and messages are a peer's word: they may have anything in them.
    """
    return _bounded(value, _DEEPEST, [_MOST_VALUES])


def _bounded(value: Any, depth: int, left: list[int]) -> Any:
    left[0] -= 1
    if isinstance(value, str):
        text = escape_text(value[:_MOST_CHARACTERS])[:_MOST_CHARACTERS]
        left[0] -= len(text) // _SHORT
        return text if len(value) <= _MOST_CHARACTERS else f"{text}…"
    if not isinstance(value, dict | list):
        return value
    if depth == 0 or left[0] <= 0:
        return _OMITTED
    items = list(value.items()) if isinstance(value, dict) else list(enumerate(value))
    found = []
    for name, each in items[:_MOST_ITEMS]:
        if left[0] <= 0:
            break
        shown = escape_text(str(name)[:200])
        left[0] -= len(shown) // _SHORT
        found.append((shown, _bounded(each, depth - 1, left)))
    omitted = len(items) - len(found)
    if isinstance(value, list):
        return [each for _, each in found] + ([{_OMITTED: omitted}] if omitted else [])
    return dict(found) | ({_OMITTED: omitted} if omitted else {})
