"""The file by which an operator's console reaches a fleet: its Zenoh network, who the operator is, and their key."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_bridge.config.decoding import read
from rsb_bridge.config.keys import Key, key_path, read_key
from rsb_bridge.config.rights import operator_name_problem
from rsb_bridge.config.validation import settings_problems
from rsb_bridge.config.yaml_text import SessionError, read_text, read_yaml
from rsb_bridge.model.session import Problem, ZenohSettings
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from pathlib import Path


class FleetMistake(Wording):
    """A mistake in a fleet's file."""

    OPERATOR_MISSING = "missing: give a name that the engines' sessions have under operators"
    KEY_FILE_MISSING = "missing: give the file of the operator's key"


class FleetFile(NamedTuple):
    """The contents of such a file.

    Attributes:
        operator: as its engines' sessions name them.
        base: the folder that the files it names are relative to.
    """

    zenoh: ZenohSettings
    operator: str
    key: Key
    base: Path


class Fleet(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file's keys; a message calls what lacks all of them by this name."""

    zenoh: ZenohSettings = ZenohSettings()
    operator: str = ""
    key_file: str = ""


def load_fleet(path: Path) -> FleetFile:
    """Read such a file.

    Raises:
        SessionError: it can't be read, or has mistakes.
        KeyFileError: the key can't be read.
    """
    document = read_yaml(read_text(path), path)
    problems = list(document.problems)
    written = read(document.data, Fleet, problems)
    if not problems:
        problems += settings_problems(written.zenoh, "zenoh")
        if not written.operator.strip():
            problems.append(Problem("operator", FleetMistake.OPERATOR_MISSING()))
        elif problem := operator_name_problem(written.operator):
            problems.append(Problem("operator", problem))
        if not written.key_file.strip():
            problems.append(Problem("key_file", FleetMistake.KEY_FILE_MISSING()))
    if problems:
        raise SessionError(path, [document.locate(problem) for problem in problems])
    base = path.parent
    return FleetFile(written.zenoh, written.operator, read_key(key_path(base, written.key_file)), base)
