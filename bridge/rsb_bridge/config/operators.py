"""The operators of a session, who attach over a network: the rules, and their keys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.config.decoding import join, show
from rsb_bridge.config.keys import KeyFileError, fingerprint, key_path, read_key
from rsb_bridge.model.limits import NAME_BYTES, OPERATORS
from rsb_bridge.model.session import Problem
from rsb_bridge.model.text import is_clean

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from rsb_bridge.config.keys import Key
    from rsb_bridge.model.session import Operator, Session


@dataclass(frozen=True, slots=True)
class Granted:
    """What an operator may do, and what they prove themselves with.

    Attributes:
        operator: as the session has them.
        key: what is in their key file.
    """

    operator: Operator
    key: Key

    def __str__(self) -> str:
        return f"may {self.operator.may}, key {fingerprint(self.key)}"


def operator_problems(session: Session) -> Iterator[Problem]:
    """All mistakes in a session's operators, as far as can be told without reading their keys."""
    if len(session.operators) > OPERATORS:
        yield Problem("operators", f"{len(session.operators)} are too many: at most {OPERATORS}")
    firsts: dict[str, int] = {}
    for at, operator in enumerate(session.operators):
        location = join("operators", at)
        name, file = operator.name, operator.key_file
        if not name.strip() or not (name.isprintable() and is_clean(name)):
            yield Problem(join(location, "name"), f"{show(name)} is not a name: give printable characters")
        elif len(name.encode()) > NAME_BYTES:
            yield Problem(join(location, "name"), f"has {len(name.encode())} bytes in UTF-8; at most {NAME_BYTES}")
        elif (first := firsts.setdefault(name, at)) != at:
            text = f"{show(name)} is the name of operator number {first + 1} already"
            yield Problem(join(location, "name"), text)
        if not (file.strip() and file.isprintable()):
            text = f"{show(file)} is not a file name: give the file of the operator's key"
            yield Problem(join(location, "key_file"), text)


def granted_operators(session: Session, base: Path, keys: Mapping[str, tuple[Key, ...]]) -> dict[str, Granted]:
    """What the operators of a session may do, by their names.

    Args:
        session: whose.
        base: the folder that its key files are relative to.
        keys: of its links, by the clients' names.

    Raises:
        KeyFileError: a key file is not there or holds no key, or two have the same key.
    """
    owners = {key.secret: f"the link of {name}" for name, valid in keys.items() for key in valid}
    granted: dict[str, Granted] = {}
    for operator in session.operators:
        path = key_path(base, operator.key_file)
        key = read_key(path)
        if other := owners.get(key.secret):
            raise KeyFileError(
                f"{path}: operator {operator.name} has the key of {other}, and could take its place: "
                "make a key of its own with `rsb-console keygen`"
            )
        owners[key.secret] = f"operator {operator.name}"
        granted[operator.name] = Granted(operator, key)
    return granted


def operator_changes(old: Mapping[str, Granted], new: Mapping[str, Granted]) -> list[str]:
    """How the operators differ, in words: who is detached by that."""
    texts = [f"operator {name}: removed, and detached" for name in old if name not in new]
    for name, granted in new.items():
        before = old.get(name)
        if before is None:
            texts.append(f"operator {name}: added, {granted}")
        elif before != granted:
            texts.append(f"operator {name}: {before} → {granted}; detached, and attaches again")
    return texts
