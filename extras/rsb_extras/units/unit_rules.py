"""Rules on the units of a session and on the right to ask for them, and what `check` says of both."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from rsb_bridge.config.name_rules import name_problems
from rsb_bridge.feature_api import Range, Wording, one_line, program_problem, program_warnings
from rsb_extras.units import MAY_ASK, UNITS, ListedUnit
from rsb_extras.units.unit_records import ACTIONS, MOST_UNITS, NAME

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rsb_bridge.feature_api import Client, Session

TIMEOUT = Range(1, 120)
"""s for an action. Round figures: an operator waits for it, and Nav2's nodes take a minute on a small computer."""
_COMMANDS = (*ACTIONS, "status", "log")
_WORDS, _LENGTH = 64, 4096
"""Words of a command, and characters of all of them. Round figures, far below what the kernel takes (execve(2))."""
_NODES = 64


class UnitRulesText(Wording):
    TOO_MANY = "has {count} units: at most {most}"
    NAME = "{name} is no name of a unit: 1 to 63 letters, digits, _ and -"
    NO_ACTION = "has none of start, stop, restart and status: give at least one"
    NO_PROGRAM = "begins with an empty word: give a program"
    RELATIVE = "{program}: give an absolute path, or a name that is found in PATH"
    NUL = "has a NUL character: remove it"
    NOT_TEXT = "has half of a character, a surrogate, which no program can get: remove it"
    TOO_LONG = "has more than {words} words or {characters} characters: put it into a script"
    TOO_MANY_NODES = "has {count} nodes: at most {most}"
    TIMEOUT = "{value:g} s is out of range: {range}"
    NO_UNIT = "{name} is no unit of this session: list it under units, or take it away here"
    NOT_RUN = "{problem}; until this is corrected, {action} of the unit fails"
    NO_STATUS = "has no status: nobody sees whether it runs, or whether it came back"
    NO_NODES = "has no nodes: the other side cannot ask for it while anything is armed"
    RUNS = "unit {name}: {action} runs {command}"
    LOOKS = "unit {name}: status runs {command}, whenever an operator or any other side looks"
    LOGS = "unit {name}: log runs {command}, after an action that failed"
    MAY = "{peer} may start, stop and restart, as far as they have that: {names}"


def problems(session: Session) -> Iterator[tuple[str, str]]:
    """Yield the mistakes, as `Feature.problems`."""
    units = UNITS.of(session)
    if len(units) > MOST_UNITS:
        yield UNITS.name, UnitRulesText.TOO_MANY(count=len(units), most=MOST_UNITS)
    for name, unit in units.items():
        place = f"{UNITS.name}.{name}"
        if NAME.fullmatch(name) is None:
            yield place, UnitRulesText.NAME(name=one_line(name))
        yield from _unit_problems(unit, place)
    holders: list[tuple[str, Session | Client]] = [("may.units", session)]
    holders += [(f"clients[{at}].may.units", each) for at, each in enumerate(session.listed_clients)]
    for place, holder in holders:
        for at, name in enumerate(MAY_ASK.of(holder)):
            if name not in units:
                yield f"{place}[{at}]", UnitRulesText.NO_UNIT(name=one_line(name))


def _unit_problems(unit: ListedUnit, place: str) -> Iterator[tuple[str, str]]:
    if not any(getattr(unit, each) for each in (*ACTIONS, "status")):
        yield place, UnitRulesText.NO_ACTION()
    for key in _COMMANDS:
        if (words := getattr(unit, key)) and (problem := _command_problem(words)):
            yield f"{place}.{key}", problem
    if len(unit.nodes) > _NODES:
        yield f"{place}.nodes", UnitRulesText.TOO_MANY_NODES(count=len(unit.nodes), most=_NODES)
    for at, node in enumerate(unit.nodes):
        found = name_problems(node, f"{place}.nodes[{at}]", "parameters")
        yield from ((problem.location, problem.message) for problem in found)
    if unit.timeout not in TIMEOUT:
        yield f"{place}.timeout", UnitRulesText.TIMEOUT(value=unit.timeout, range=TIMEOUT)


def _command_problem(words: tuple[str, ...]) -> str:
    program = words[0]
    if not program:
        return UnitRulesText.NO_PROGRAM()
    if "/" in program and not program.startswith("/"):
        return UnitRulesText.RELATIVE(program=one_line(program))
    if any("\0" in word for word in words):
        return UnitRulesText.NUL()
    if any(0xD800 <= ord(character) <= 0xDFFF for word in words for character in word):
        return UnitRulesText.NOT_TEXT()
    if len(words) > _WORDS or sum(map(len, words)) > _LENGTH:
        return UnitRulesText.TOO_LONG(words=_WORDS, characters=_LENGTH)
    return ""


def advice(session: Session, file: Path | None) -> Iterator[tuple[str, str]]:
    """Yield advice, as `Feature.advice`."""
    asked = {name for holder in (session, *session.listed_clients) for name in MAY_ASK.of(holder)}
    for name, unit in UNITS.of(session).items():
        place = f"{UNITS.name}.{name}"
        if not unit.status:
            yield place, UnitRulesText.NO_STATUS()
        if name in asked and not unit.nodes:
            yield place, UnitRulesText.NO_NODES()
        for action in _COMMANDS if file is not None else ():
            yield from ((f"{place}.{action}", text) for text in _warnings(getattr(unit, action), action, file))


def _warnings(words: tuple[str, ...], action: str, file: Path | None) -> Iterator[str]:
    if words and file is not None:
        if problem := program_problem(words[0], file.parent):
            yield UnitRulesText.NOT_RUN(problem=problem, action=action)
        yield from program_warnings(words[0], file)


def effects(session: Session) -> Iterator[str]:
    """Yield the commands that this side may run, and the peers that may ask for them."""
    for name, unit in UNITS.of(session).items():
        for action in _COMMANDS:
            if words := getattr(unit, action):
                text = {"status": UnitRulesText.LOOKS, "log": UnitRulesText.LOGS}.get(action, UnitRulesText.RUNS)
                yield text(name=name, action=action, command=shlex.join(words))
    clients = session.accepted_clients if session.role == "server" else ()
    holders = [(client.name, MAY_ASK.of(client)) for client in clients] or [("the server", MAY_ASK.of(session))]
    for peer, names in holders:
        if names:
            yield UnitRulesText.MAY(peer=peer, names=", ".join(names))
