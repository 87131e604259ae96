"""The operators of a session, who may attach to its bridge over a network: their entries, and their keys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.config.decoding import join, show
from rsb_bridge.config.keys import KeyFileError, fingerprint, key_path, read_key
from rsb_bridge.model.limits import NAME_BYTES, OPERATORS
from rsb_bridge.model.session import Problem
from rsb_bridge.model.text import is_clean
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Collection, Hashable, Iterator, Mapping
    from pathlib import Path

    from rsb_bridge.config.keys import Key
    from rsb_bridge.model.session import Operator, Session


class OperatorMistake(Wording):
    KEY_FILE_INVALID = "{file} is not a file name: give the file of the operator's key"
    SHARED_KEY = (
        "operator {name} has the key of {other}, so that either can pass for the other: make a key of its own "
        "with `rsb-console keygen`"
    )


@dataclass(frozen=True, slots=True)
class Granted:
    """An operator, and the contents of their key file."""

    operator: Operator
    key: Key

    def __str__(self) -> str:
        return f"may {self.operator.may}, key {fingerprint(self.key)}"


def operator_problems(session: Session) -> Iterator[Problem]:
    """Yield all mistakes in a session's operators, without those in their keys."""
    if len(session.operators) > OPERATORS:
        yield Problem("operators", f"{len(session.operators)} are too many: at most {OPERATORS}")
    firsts: dict[str, int] = {}
    for at, operator in enumerate(session.operators):
        location = join("operators", at)
        name, file = operator.name, operator.key_file
        if problem := operator_name_problem(name):
            yield Problem(join(location, "name"), problem)
        elif (first := firsts.setdefault(name, at)) != at:
            yield Problem(join(location, "name"), f"{show(name)} is the name of operator number {first + 1} already")
        if not (file.strip() and file.isprintable()):
            yield Problem(join(location, "key_file"), OperatorMistake.KEY_FILE_INVALID(file=show(file)))


def operator_name_problem(name: str) -> str:
    if not name.strip() or not (name.isprintable() and is_clean(name)):
        return f"{show(name)} is not a name: give printable characters"
    if len(name.encode()) > NAME_BYTES:
        return f"has {len(name.encode())} bytes in UTF-8; at most {NAME_BYTES}"
    return ""


def granted_operators(session: Session, base: Path, keys: Mapping[str, tuple[Key, ...]]) -> dict[str, Granted]:
    """Read the keys of a session's operators.

    Args:
        base: the folder that its key files are relative to.
        keys: of its links, by the clients' names.

    Raises:
        KeyFileError: a key file is not there or holds no key, or an operator has somebody else's key.
    """
    own = {each.name: read_key(key_path(base, each.key_file)) for each in session.operators}
    if problem := operator_key_problem(own, keys):
        raise KeyFileError(problem)
    return {each.name: Granted(each, own[each.name]) for each in session.operators}


def operator_key_problem(own: Mapping[str, Hashable], of_links: Mapping[str, Collection[Hashable]]) -> str:
    """Return the problem and the remedy if an operator shares a key with another or with a link, or an empty string.

    Args:
        own: each operator's key, or its fingerprint, by name.
        of_links: the keys that are valid on each link, or their fingerprints, by the client's name.
    """
    owners = {key: f"the link of {name}" for name, valid in of_links.items() for key in valid}
    for name, key in own.items():
        if other := owners.get(key):
            return OperatorMistake.SHARED_KEY(name=name, other=other)
        owners[key] = f"operator {name}"
    return ""


def operator_changes(old: Mapping[str, Granted], new: Mapping[str, Granted]) -> list[str]:
    """Describe the changes of operators, and name detached operators."""
    texts = [f"operator {name}: removed, and detached" for name in old if name not in new]
    for name, granted in new.items():
        before = old.get(name)
        if before is None:
            texts.append(f"operator {name}: added, {granted}")
        elif before != granted:
            texts.append(f"operator {name}: {before} → {granted}; detached, and has to attach again")
    return texts
