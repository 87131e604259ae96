"""The command ``check``: describes a session, and lists the problems to fix first."""

from __future__ import annotations

import os
import time
from itertools import chain
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.cdr.known_types import DRIVING_TYPES
from rsb_bridge.config.advice import advise, guarded_here_alone, moves_a_robot, uninstalled_types, with_late_commands
from rsb_bridge.config.file_form import LISTS, NOUNS
from rsb_bridge.config.keys import (
    Key,
    KeyFileError,
    fingerprint,
    key_files_by_client,
    key_users,
    key_warnings,
    session_keys,
    shared_key_problem,
    written,
)
from rsb_bridge.config.operator_keys import operator_key_problem
from rsb_bridge.config.rights_listing import listings
from rsb_bridge.config.session_file import SessionError, demand_places, load
from rsb_bridge.config.topic_rules import transport_of
from rsb_bridge.config.validation import domain_of
from rsb_bridge.config.yaml_text import inline
from rsb_bridge.installed_features import added
from rsb_bridge.model.by_hand import END_CANCEL
from rsb_bridge.model.demands import Demands, demand_on_entry, describe, full_type, sources_of
from rsb_bridge.model.keep import KEEP_BUDGET
from rsb_bridge.model.motion import LATEST
from rsb_bridge.model.session import Grant
from rsb_bridge.model.text import join_first
from rsb_bridge.model.topic_keys import TOPIC_KEYS
from rsb_bridge.model.transports import PROFILES, compression_of, of_link, profile_of, profile_text
from rsb_bridge.model.wording import Wording
from rsb_console.command.formatting import json_line
from rsb_console.command.shell import NO_KEY, OK, USAGE, print_error, print_line

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from rsb_bridge.model.demands import Demand, DemandSource, SourceKey
    from rsb_bridge.model.session import Client, Session, Topic
    from rsb_bridge.model.transport_traits import Compression
    from rsb_bridge.model.transports import LinkProfile

_NAMED = 6
"""Names in a line; the others are counted. A round figure."""


class SessionCheckText(Wording):
    """Warnings and hints of `rsb-console check`."""

    MAY_MOVE = "{peer} may publish topics that move a robot: {names}"
    MAY_ACT = "{peer} may call services that move or change a robot: {names}"
    SERVER_MAY_STOP = "the server may shut this bridge down"
    NODES_MAY_STOP = "any ROS node of this domain may shut the bridge down, on {topic}"
    NO_OTHER_GUARD = (
        "hint: nothing stops what {names} drives if this bridge is killed or frozen: give the robot's base a timeout"
    )
    LATE_COMMANDS = (
        "hint: old commands of {names} move a robot when the network recovers: leave out keep, and max_age: none"
    )
    OF_COMMANDS = ", dropped if older than {seconds:g} s beyond the link's usual delay"
    KEEPS = "keeps {kept} for the link"
    KEPT_NOTHING = "so that nothing is kept after all"
    KEPT = "keep: at most {size} MiB a link ({names})"
    LIMITED = ", at most {limits} by hand ({lines})"
    LIMITED_PATTERN = "at most {limits} by hand"
    ENDS_WITH = "; when that ends, the robot gets {message} ({line})"
    ENDS_WITH_ZERO = "; when that ends, the robot gets zero"
    CANCELS = "; when that ends, its goals are cancelled ({line})"
    GOALS_GO_ON = "; when that ends, its goals go on, unless on_end is cancel"
    ENDS_WITH_NOTHING = "; when that ends, the robot gets nothing"
    ENDS_AS_THERE = "; when that ends, the robot gets what its own session says"
    ENDS_AS_THERE_OR_ZERO = "; when that ends, the robot gets zero, or what its own session says"
    PREFIX_IF_USED = "prefix /{name} if the server has use_name on"
    OWN_PORTS = "ports of its own"
    KEY_MISSING = "{problem}; without it the bridge does not start"
    KEY = "key {file}, for {users}: {fingerprint}, written {age}"


def summary(session: Session, places: Mapping[SourceKey, str] | None = None) -> Iterator[str]:
    """Describe a session, line by line.

    Args:
        places: places in its file that demand arming, by the keys of the lines.
    """
    demands, places = Demands(sources_of(session)), places or {}
    place = of_link(session.host).place(session)
    yield f"{session.role} {session.name} {place}, {_domain(session)}"
    prefix = _prefix_of(session.name if session.clients is None else "<name>", use_name=session.use_name)
    if session.role == "client" and not session.use_name:
        prefix = SessionCheckText.PREFIX_IF_USED(name=session.name)
    yield f"encryption {'on' if session.use_encryption else 'OFF'}, {prefix}"
    if session.profile is not None:
        yield f"profile {session.profile}: {profile_text(PROFILES[session.profile])}"
    yield from added("effects", session)
    for topic in session.topics:
        demanded = _demands_on(topic, session, None, demands, places)
        yield f"  {_route(topic, session, profile_of(session.profile))}{demanded}"
    for client in session.listed_clients:
        allowed, denied = _grants(client.allow) or "everything", _grants(client.deny)
        prefix = "" if client.use_name is None else f", {_prefix_of(client.name, use_name=client.use_name)}"
        yield f"  accepts {client.name}: {allowed}{', not ' if denied else ''}{denied}{prefix}"
        if client.profile is not None:
            yield f"    profile {client.profile}: {profile_text(PROFILES[client.profile])}"
        for topic in client.topics:
            demanded = _demands_on(topic, session, client, demands, places)
            yield f"    proposes {_route(topic, session, profile_of(client.profile, session.profile))}{demanded}"
    everywhere = chain(session.topics, *(client.topics for client in session.listed_clients))
    if kept := tuple(dict.fromkeys(each.topic for each in everywhere if each.kept and not each.kept.own_bytes)):
        yield f"  {SessionCheckText.KEPT(names=join_first(kept, _NAMED), size=KEEP_BUDGET >> 20)}"
    if session.role == "server" and session.clients is None:
        yield f"  accepts {session.name}: everything"
    if session.clients == ():
        yield "  accepts nobody yet: `rsb-console client add NAME` adds a client"
    for source in filter(lambda each: each.arm, demands.sources):
        yield f"  requires arming on all its routes: {_demanded(source, places)}"


def _demands_on(
    topic: Topic, session: Session, client: Client | None, demands: Demands, places: Mapping[SourceKey, str]
) -> str:
    """Describe the demands on an entry, or on its name, that the entry itself does not show."""
    demand = demand_on_entry(demands, session, client, topic)
    limit = f", dropped if older than {demand.max_age:g} s" if demand.max_age and not topic.max_age else ""
    if moves_a_robot(topic) and topic.max_age is None and demand.max_age is None and topic.kept is None:
        limit = SessionCheckText.OF_COMMANDS(seconds=LATEST)
    if demand.limits is not None:
        lines = ", ".join(describe(source, places) for source in demand.limited_by)
        limit += SessionCheckText.LIMITED(limits=demand.limits, lines=lines)
    # A demand may be about age or limits only.
    if not demand.arm:
        return limit
    keys = f"within {demand.deadman:g} s" if demand.deadman else "never"
    lines = ", ".join(describe(source, places) for source in demand.sources)
    kept = f", {SessionCheckText.KEPT_NOTHING()}" if topic.kept is not None else ""
    return f"{limit}, has to be armed ({lines}; keys needed: {keys}){kept}{_end_of(demand, topic, client, places)}"


def _end_of(demand: Demand, topic: Topic, client: Client | None, places: Mapping[SourceKey, str]) -> str:
    """Describe the end of an arming for the robot, with the line that demands it, or return an empty string."""
    if topic.kind not in ("topic", "action"):
        return ""
    type_name = full_type(topic.type)
    if topic.kind == "topic" and (topic.direction == "transmit") == (client is None):
        drives = not type_name or type_name in DRIVING_TYPES
        return SessionCheckText.ENDS_AS_THERE_OR_ZERO() if drives else SessionCheckText.ENDS_AS_THERE()
    line = next((each for each in demand.sources if demand.on_end and each.on_end == demand.on_end), None)
    if line is not None:
        place = describe(line, places)
        if demand.on_end == END_CANCEL:
            return SessionCheckText.CANCELS(line=place)
        return SessionCheckText.ENDS_WITH(message=demand.on_end, line=place) if topic.kind == "topic" else ""
    if topic.kind == "action":
        return SessionCheckText.GOALS_GO_ON()
    if not type_name:
        return "; when that ends, the robot gets zero if the type drives robots"
    return SessionCheckText.ENDS_WITH_ZERO() if type_name in DRIVING_TYPES else SessionCheckText.ENDS_WITH_NOTHING()


def _demanded(source: DemandSource, places: Mapping[SourceKey, str]) -> str:
    kind = f"{source.kind} " if source.kind not in (None, "topic") else ""
    excepts = f", not {join_first(source.excepts, _NAMED)}" if source.excepts else ""
    limits = "" if source.limits is None else f", {SessionCheckText.LIMITED_PATTERN(limits=source.limits)}"
    if source.on_end:
        line = describe(source, places)
        ends = SessionCheckText.CANCELS if source.on_end == END_CANCEL else SessionCheckText.ENDS_WITH
        return f"{kind}{source.name}{excepts}{limits}{ends(message=source.on_end, line=line)}"
    place = f" ({places[source.key]})" if source.key in places else ""
    return f"{kind}{source.name}{excepts}{limits}{place}"


def _grants(entries: Iterable[str | Grant]) -> str:
    return ", ".join(inline(msgspec.to_builtins(each)) if isinstance(each, Grant) else each for each in entries)


def rights(session: Session) -> Iterator[str]:
    """Yield a table of each peer's rights on this side, and warnings about rights that move or change a robot."""
    found = list(listings(session))
    heads = ("may do here", "", "what", "over", "rate", SessionCheckText.OWN_PORTS())
    rows: list[tuple[str, ...]] = [heads, *(row for listing in found for row in listing.rows)]
    rows = rows if session.role == "server" else [row[:-1] for row in rows]  # a client binds none
    widths = [max(len(row[at]) for row in rows) for at in range(len(rows[0]))]
    for row in rows:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
    for listing in found:
        if listing.moves:
            yield f"  {SessionCheckText.MAY_MOVE(peer=listing.peer, names=', '.join(listing.moves))}"
        if listing.acts:
            acts = join_first(listing.acts, _NAMED)
            yield f"  {SessionCheckText.MAY_ACT(peer=listing.peer, names=acts)}"
    if session.role == "client":
        yield f"  {SessionCheckText.SERVER_MAY_STOP()}"
    if session.shutdown_topic is not None:
        yield f"  {SessionCheckText.NODES_MAY_STOP(topic=session.shutdown_topic)}"


def hints(session: Session) -> Iterator[str]:
    """Yield advice about a session without mistakes."""
    if alone := tuple(dict.fromkeys(guarded_here_alone(session))):
        yield SessionCheckText.NO_OTHER_GUARD(names=join_first(alone, _NAMED))
    if late := tuple(dict.fromkeys(with_late_commands(session))):
        yield f"  {SessionCheckText.LATE_COMMANDS(names=join_first(late, _NAMED))}"


def _domain(session: Session) -> str:
    try:
        domain = domain_of(session, os.environ.get("ROS_DOMAIN_ID"))
    except ValueError:  # which is a warning
        return "no ROS domain"
    return f"ROS domain {domain}{' (ROS_DOMAIN_ID, else 0)' if session.domain_id is None else ''}"


def _prefix_of(name: str, *, use_name: bool) -> str:
    return f"prefix /{name}" if use_name else "no prefix"


def _route(topic: Topic, session: Session, profile: LinkProfile) -> str:
    transport = transport_of(topic, session)
    compression = compression_of(topic.compression, profile, transport.compression)
    details = list(_details(topic, compression))
    if topic.kind == "topic":
        what = f"{topic.direction} {'each that matches ' if topic.is_pattern else ''}{topic.topic}"
    else:
        what = f"{_noun(topic)} {topic.topic}, provided by the {topic.provider},"
    return f"{what} over {transport.name}: {', '.join(details)}"


def _noun(topic: Topic) -> str:
    if not topic.is_pattern:
        return NOUNS[LISTS[topic.kind]]
    return f"each {topic.kind} that matches" if topic.kind != "parameters" else "parameters of each node that matches"


def _details(topic: Topic, compression: Compression) -> Iterator[str]:
    if topic.kind != "parameters":
        yield f"type {topic.type}"
    yield f"qos {topic.qos}" if topic.kind == "topic" else f"given up after {topic.call_timeout:g} s"
    if topic.port is not None:
        yield f"port {topic.port}"
    if compression != "none":
        yield f"{compression} compression"
    if topic.excepts:
        yield f"not {join_first(topic.excepts, _NAMED)}"
    if topic.remote_topic is not None:
        yield f"{topic.remote_topic} on the server"
    given = msgspec.to_builtins(topic)  # without what is at its default
    given |= given.pop("features", {})
    for name, key in TOPIC_KEYS.items():
        if name in given and key.sentence:
            yield key.described(given[name], topic.kind)
    if topic.paused:
        yield "paused"
    if topic.arm and topic.is_pattern:
        keys = f"within {topic.deadman_seconds:g} s" if topic.deadman_seconds else "never"
        yield f"has to be armed (keys needed: {keys})"
    if topic.kept is not None:
        yield SessionCheckText.KEEPS(kept=topic.kept)
    if topic.limits is not None and topic.is_pattern:
        yield SessionCheckText.LIMITED_PATTERN(limits=topic.limits)


def check_session(arguments: Namespace) -> int:
    """Print a session's effects and the problems to fix first; a missing key has its own exit code."""
    path: Path = arguments.session
    try:
        session = load(path)
    except SessionError as error:
        if not arguments.json:
            return print_mistakes(error)
        mistakes = [{"line": each.line, "key": each.location, "text": each.message} for each in error.problems]
        print_line(json_line({"ok": False, "file": str(path), "error": str(error), "mistakes": mistakes}))
        return USAGE
    # Each key is read once, so that lines and exit code agree even if a file changes meanwhile.
    keys = dict(session_keys(session, path.parent))
    effects = [*summary(session, demand_places(path)), *rights(session), *hints(session), *_key_lines(session, keys)]
    warnings = [*_warnings(session, keys, path)]
    if problem := _shared_keys(session, keys):
        problem = f"the bridge does not start: {problem}"
    missing = any(isinstance(key, KeyFileError) for key in keys.values())
    code = USAGE if problem else NO_KEY if missing else OK
    if arguments.json:
        found: dict[str, object] = {"ok": code == OK, "file": str(path), "name": session.name, "role": session.role}
        found |= {"mistakes": [], "effects": [line.strip() for line in effects], "warnings": warnings}
        print_line(json_line(found | ({"error": problem or warnings[0]} if code != OK else {})))
        return code
    for line in chain(effects, (f"warning: {warning}" for warning in warnings)):
        print_line(line)
    if problem:
        print_error(problem)
    return code


def print_mistakes(error: SessionError) -> int:
    """Print the mistakes of a session file, as a whole or by line."""
    in_lines = any(problem.line for problem in error.problems)
    print_error(f"a session file with mistakes\n{error}" if in_lines else str(error))
    return USAGE


def _warnings(session: Session, keys: Mapping[str, Key | KeyFileError], file: Path) -> Iterator[str]:
    """Yield the warnings that running the session would give."""
    yield from (SessionCheckText.KEY_MISSING(problem=key) for key in keys.values() if isinstance(key, KeyFileError))
    valid = {
        name: tuple(key for file in files if isinstance(key := keys.get(file), Key))
        for name, files in key_files_by_client(session).items()
    }
    operators = {
        f"operator {each.name}": (key,) for each in session.operators if isinstance(key := keys.get(each.key_file), Key)
    }
    yield from key_warnings(valid | operators, time.time())
    variables = os.environ.get("ROS_DOMAIN_ID"), os.environ.get("RMW_IMPLEMENTATION", "")
    yield from map(str, advise(session, *variables, file))
    yield from map(str, uninstalled_types(session))


def _key_lines(session: Session, keys: Mapping[str, Key | KeyFileError]) -> Iterator[str]:
    """Yield the users and the age of each key."""
    users = key_users(session)
    for file, key in keys.items():
        if isinstance(key, Key):
            yield SessionCheckText.KEY(
                file=file, users=users[file], fingerprint=fingerprint(key), age=written(key, time.time())
            )


def _shared_keys(session: Session, keys: Mapping[str, Key | KeyFileError]) -> str:
    """Return the reason why keys of clients or operators are refused; an unreadable key is compared by its file."""

    def read(file: str) -> Key | str:
        return key if isinstance(key := keys[file], Key) else file

    files = key_files_by_client(session).items() if session.use_encryption else ()
    of_links = {name: [*map(read, of_client)] for name, of_client in files}
    shared = shared_key_problem(session, of_links) if session.role == "server" else ""
    return shared or operator_key_problem({each.name: read(each.key_file) for each in session.operators}, of_links)
