"""A topic while an operator writes it, in a form or as ``KEY=VALUE``: its texts, the topic they make, its mistakes."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from rsb_bridge.config.decoding import read
from rsb_bridge.config.file_form import DIRECTIONS, KEYS, field_of, hints_of, key_of, locations
from rsb_bridge.config.overlaps import overlaps
from rsb_bridge.config.session_file import SessionError, validate, validate_topic
from rsb_bridge.config.yaml_text import read_yaml
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.keep import Keep
from rsb_bridge.model.names import client_topic
from rsb_bridge.model.session import Problem, Session, Topic
from rsb_bridge.model.topic_keys import ADDED_KEYS, keys_of_value
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rsb_bridge.model.snapshot import Snapshot

_NUMBERS, SWITCHES, CHOICES = keys_of_value("number"), keys_of_value("switch"), keys_of_value("choice")
"""The keys that are on or off, and those that may be left open, too. Every text outside `_OFF` means on."""
_PARTS: dict[str, type[msgspec.Struct]] = {"limits": VelocityLimits, "keep": Keep}
"""The keys whose values may have parts."""
_OFF = ("", "false", "no", "off")


@dataclass(frozen=True, slots=True)
class Ends:
    """The two ends of a topic's link.

    Attributes:
        is_server: whether this side is the server.
        use_name: whether topic names on the server have the client's name as a prefix.
    """

    is_server: bool
    client: str
    use_name: bool

    @classmethod
    def of(cls, now: Snapshot, client: str) -> Ends:
        """Return the ends of a running engine's link, chosen by the client's name."""
        return cls(now.role == "server", client, any(link.use_name for link in now.links if link.name == client))

    def client_topic(self, topic: str, *, on_server: bool) -> str | None:
        """Return a topic's name on the client, or None for a server's topic without this client's prefix."""
        return client_topic(topic, self.client) if on_server and self.use_name else topic


def plain(key: str, text: str) -> Any:
    """Convert a field's text as a session file would; text in place of a number stays, for the rules to refuse."""
    if key == "qos":
        return int(text) if text.isdecimal() else _mapping(text)
    if (parts := _PARTS.get(key)) is not None and text.startswith("{"):
        return _plain_parts(text, parts)
    if key == "excepts":
        return tuple(text.replace(",", " ").split())
    if key in CHOICES:
        return text.lower() not in _OFF
    if key not in _NUMBERS and key != "keep":
        return text
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _plain_parts(text: str, parts: type[msgspec.Struct]) -> Any:
    data, problems = _mapping(text), list[Problem]()
    value = read(data, parts, problems) if isinstance(data, dict) else data
    return data if problems else value


def _mapping(text: str) -> Any:
    """Return the mapping that a text is, or the text."""
    if text.startswith("{"):
        try:
            return read_yaml(text, Path("field")).data
        except SessionError:
            return text
    return text


def topic_of(values: Mapping[str, str]) -> Topic:
    """Build a topic from a form's texts. It may have any of the problems of `problems_of`.

    For kinds other than topics, a ``provider`` may replace the direction.
    """
    given = {key: plain(key, text) for key, text in values.items() if text and key not in SWITCHES}
    given |= {key: True for key in SWITCHES if values.get(key, "").lower() not in _OFF}
    if (provider := given.pop("provider", None)) is not None:
        given["direction"] = DIRECTIONS.get(provider, provider)
    given["features"] = {name: given.pop(name) for name in ADDED_KEYS if name in given}
    return Topic(**({"topic": "", "direction": "transmit"} | given))


def values_of(topic: Topic) -> dict[str, str]:
    """Convert a topic to a form's texts; defaults are empty."""
    values = msgspec.to_builtins(topic)
    return {key: _text(value) for key, value in (values | values.pop("features", {})).items()}


def _text(value: object) -> str:
    if isinstance(value, list):
        return " ".join(map(_text, value))
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_text(each)}' for key, each in value.items())}}}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def problems_of(topic: Topic, session: Session, replaced: Topic | None) -> dict[str, str]:
    """Return the problems of a topic, by itself and together with the session's others.

    Args:
        topic: as the client sees it.
        session: session of the topic. A server's session has no topics to conflict: the client checks those.
        replaced: topic of the session that it replaces, or None.

    Returns:
        Messages by the key of the field.
    """
    if session.role == "server":
        found = validate_topic(topic, session)
    else:
        others = tuple(each for each in session.topics if each != replaced)
        here = locations((*others, topic))[-1]
        problems = validate(msgspec.structs.replace(session, topics=(*others, topic)))
        # In a file the kinds have their own order, by which it may be another entry that is one too many.
        problems += overlaps((*others, topic))
        found = [
            replace(problem, location=problem.location.removeprefix(here).lstrip("."))
            for problem in problems
            if problem.location.startswith(here)
        ]
    messages: dict[str, str] = {}
    for problem in found:
        key = problem.location.partition(".")[0]
        messages.setdefault(field_of(topic.kind, key) if key else "topic", problem.message)
    return messages


class TypedProblem(Wording):
    """Reasons why ``KEY=VALUE`` words make no topic."""

    NOT_A_PAIR = "{text}: not KEY=VALUE, as in max_rate=5"


class TypedError(ValueError):
    """Keys and values that make no topic; the message names the remedy."""


def typed_topic(values: Mapping[str, str], keys: Sequence[str], session: Session, replaced: Topic | None) -> Topic:
    """Build a topic from given values and typed ones.

    Args:
        values: texts as from `rsb_console.session.draft.values_of`.
        keys: typed texts, each ``KEY=VALUE``.
        replaced: topic of the session that it replaces, or None.

    Raises:
        TypedError: the topic is invalid.
    """
    # mypy takes no plain text for a `Kind`, but a key of `KEYS`.
    kind = replaced.kind if replaced is not None else next(kind for kind in KEYS if kind == values["kind"])
    known, changed = list(KEYS[kind]), dict(values)
    for text in keys:
        key, is_pair, value = text.partition("=")
        if not is_pair:
            raise TypedError(TypedProblem.NOT_A_PAIR(text=text))
        if key not in known:
            foreign, keys = hints_of(kind).get(key), ", ".join(known)
            if foreign:
                raise TypedError(f"{text}: {foreign} (keys: {keys})")
            raise TypedError(f"{text}: unknown key{suggestion(key, known)} (keys: {keys})")
        changed[field_of(kind, key)] = DIRECTIONS.get(value, value) if key == "provider" else value
    topic = topic_of(changed)
    if problems := problems_of(topic, session, replaced):
        raise TypedError("; ".join(f"{key_of(kind, field)}: {problem}" for field, problem in problems.items()))
    return topic


def suggestion(name: str, known: Sequence[str]) -> str:
    """Return a hint at the most similar name, or an empty string if none is similar."""
    near = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {near[0]}?" if near else ""
