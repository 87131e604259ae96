"""The rules of names and patterns of topics, services, actions and nodes."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from rsb_bridge.config.decoding import Hint, join, show
from rsb_bridge.config.file_form import key_of
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.limits import TOPIC_LENGTH
from rsb_bridge.model.names import ANNOUNCEMENT_TOPIC, OWN_NAMES, is_topic_name, server_topic, well_formed
from rsb_bridge.model.patterns import EXCEPTIONS_PER_PATTERN, Pattern, is_hidden, is_pattern, is_valid
from rsb_bridge.model.session import ArmedName, Kind, Problem, Topic
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

KIND_NOUNS: Final[dict[Kind, str]] = {"topic": "topic", "service": "service", "action": "action", "parameters": "node"}
"""What has the name, by kind."""
_OF_AN_ACTION = re.compile(r"(?P<action>.*)/_action/[^/]*")


class NameMistake(Wording):
    """A mistake in a name or a pattern."""

    NO_NAME = "the {noun}'s name is empty: give an absolute one, /part/part"
    NOT_ABSOLUTE = "{name} is not an absolute {noun} name: /part/part, of letters, digits and _, no digit first{hint}"
    ANNOUNCEMENT = "{name} carries the bridges' own announcements and is never bridged: name another topic"
    NAME_TOO_LONG = "{name} has {length} characters, and ROS allows at most {limit}: shorten it"
    NAME_TOO_LONG_WITH_PREFIX = (
        "{name} has {length} characters with its prefix, and ROS allows at most {limit}: shorten it"
    )
    WILDCARDS_DIFFER = (
        "{remote} has {remote_wildcards}, and {name} has {wildcards}: give both the same wildcards in the same order"
    )
    NOT_A_PATTERN = (
        "{name} is not a pattern of names: /part/part, where * matches characters of one part, and a part ** "
        "matches any number of parts"
    )
    NEITHER_NAME_NOR_PATTERN = (
        "{name} is neither a name nor a pattern: /part/part, where * matches characters of one part, and a "
        "part ** matches any number of parts"
    )
    HIDDEN = "{name}: patterns never match hidden names, whose parts begin with _: list them by their names"
    PART_OF_ACTION = "{name} belongs to the action {action}: list the action under actions, which bridges all its parts"
    OF_THE_BRIDGE = "{name} belongs to the bridge itself and is never bridged: name another one"


def topic_name_problems(topic: Topic, client: str | None) -> Iterator[Problem]:
    """Yield the mistakes in the names and patterns of an entry.

    Args:
        client: the client's name where it is the prefix of the topic's name on the server.
    """
    name, remote = key_of(topic.kind, "topic"), key_of(topic.kind, "remote_topic")
    names = [(topic.topic, name)]
    if topic.remote_topic is not None:
        names.append((topic.remote_topic, remote))
    if topic.excepts:
        yield from _exception_problems(topic.topic, topic.excepts)
    if topic.is_pattern:
        found = [problem for each in names for problem in form_problems(*each)]
        yield from found
        # What is not valid has no wildcards to compare.
        if topic.remote_topic is not None and not found:
            yield from _wildcard_problems(topic.topic, topic.remote_topic, remote)
    else:
        for each in names:
            yield from name_problems(*each, topic.kind)
    # A name that is too long without the prefix is reported already.
    if topic.remote_topic is None and client is not None and len(topic.topic) <= TOPIC_LENGTH:
        yield from _length(server_topic(topic.topic, client), name, topic.kind, NameMistake.NAME_TOO_LONG_WITH_PREFIX)
    for text, here in names if topic.kind != "topic" else ():
        if match := _OF_AN_ACTION.fullmatch(text):
            yield Problem(here, NameMistake.PART_OF_ACTION(name=show(text), action=match["action"] or "/..."))
        elif text.startswith(OWN_NAMES):
            yield Problem(here, NameMistake.OF_THE_BRIDGE(name=show(text)))


def name_problems(name: str, location: str, kind: Kind = "topic") -> Iterator[Problem]:
    """Yield the mistake in the name of one topic or the like, which ROS must have, and a bridge may carry."""
    if not name:
        yield Problem(location, NameMistake.NO_NAME(noun=KIND_NOUNS[kind]))
    elif is_pattern(name):
        yield Problem(location, f"{show(name)} is a pattern: give the name of one {KIND_NOUNS[kind]}")
    elif not is_topic_name(name):
        better = well_formed(name)
        hint = Hint.DID_YOU_MEAN(name=f"/{better}") if better else ""
        yield Problem(location, NameMistake.NOT_ABSOLUTE(name=show(name), noun=KIND_NOUNS[kind], hint=hint))
    elif kind == "topic" and name == ANNOUNCEMENT_TOPIC:
        yield Problem(location, NameMistake.ANNOUNCEMENT(name=show(name)))
    else:
        yield from _length(name, location, kind)


_LONGEST_SUFFIX = {kind: max((len(lane.suffix) for lane in lanes), default=0) for kind, lanes in LANES.items()}


def _length(
    name: str, location: str, kind: Kind, mistake: NameMistake = NameMistake.NAME_TOO_LONG
) -> Iterator[Problem]:
    most = TOPIC_LENGTH - _LONGEST_SUFFIX[kind]
    if len(name) > most:
        yield Problem(location, mistake(name=show(name), length=len(name), limit=most))


def form_problems(text: str, location: str, *, hidden: bool = False) -> Iterator[Problem]:
    """Yield the mistake in a name or a pattern, which may match hidden names if `hidden`."""
    if is_pattern(text) and not is_valid(text):
        yield Problem(location, NameMistake.NOT_A_PATTERN(name=show(text)))
    elif not is_pattern(text) and not is_topic_name(text):
        yield Problem(location, NameMistake.NEITHER_NAME_NOR_PATTERN(name=show(text)))
    elif len(text) > TOPIC_LENGTH:
        message = NameMistake.NAME_TOO_LONG(name=show(text), length=len(text), limit=TOPIC_LENGTH)
        yield Problem(location, message)
    elif is_hidden(text) and not hidden:
        yield Problem(location, NameMistake.HIDDEN(name=show(text)))


def _wildcard_problems(name: str, remote: str, location: str) -> Iterator[Problem]:
    ours, theirs = Pattern(name).wildcards, Pattern(remote).wildcards
    if ours != theirs:
        message = NameMistake.WILDCARDS_DIFFER(
            remote=show(remote),
            remote_wildcards=" ".join(theirs) or "no wildcard",
            name=show(name),
            wildcards=" ".join(ours) or "no wildcard",
        )
        yield Problem(location, message)


def _exception_problems(name: str, excepts: Sequence[str]) -> Iterator[Problem]:
    if excepts and not is_pattern(name):
        yield Problem("except", f"{show(name)} is a single name, not a pattern: leave except out")
    elif len(excepts) > EXCEPTIONS_PER_PATTERN:
        message = f"{len(excepts)} entries, and at most {EXCEPTIONS_PER_PATTERN} are allowed: use patterns in it"
        yield Problem("except", message)
    else:
        for at, each in enumerate(excepts):
            yield from form_problems(each, join("except", at), hidden=True)


def armed_name_problems(entry: ArmedName) -> Iterator[Problem]:
    """Yield the mistakes in what a line of `armed` says of a client's names."""
    if entry.topic is not None:
        found = list(form_problems(entry.topic, "topic", hidden=True))
        yield from found
        if not found and not list(form_problems(entry.name, "name", hidden=True)):
            yield from _wildcard_problems(entry.name, entry.topic, "topic")
    yield from _exception_problems(entry.name, entry.excepts)
