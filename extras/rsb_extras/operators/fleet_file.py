"""The file by which an operator's console reaches a fleet."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_bridge.config.decoding import read
from rsb_bridge.config.keys import Key, key_path, read_key
from rsb_bridge.config.operator_keys import operator_name_problem
from rsb_bridge.config.yaml_text import SessionError, read_text, read_yaml
from rsb_bridge.feature_api import Wording
from rsb_bridge.model.session import Problem
from rsb_extras.zenoh import ZenohSettings
from rsb_extras.zenoh.zenoh_rules import settings_problems

if TYPE_CHECKING:
    from pathlib import Path


class FleetMistake(Wording):
    """A mistake in a fleet's file."""

    OPERATOR_MISSING = "missing: give a name that the engines' sessions have under operators"
    KEY_FILE_MISSING = "missing: give the file of the operator's key"


class FleetFile(NamedTuple):
    """The file by which an operator's console reaches a fleet; the files it names are relative to its folder."""

    zenoh: ZenohSettings
    operator: str
    key: Key
    path: Path


class Fleet(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file's keys; a message calls what lacks all of them by this name."""

    zenoh: ZenohSettings = ZenohSettings()
    operator: str = ""
    key_file: str = ""


def load_fleet(path: Path) -> FleetFile:
    """Read a fleet's file. Raise SessionError or KeyFileError if it or the key cannot be read, or has mistakes."""
    document = read_yaml(read_text(path), path)
    problems = list(document.problems)
    written = read(document.data, Fleet, problems)
    if not problems:
        problems += [Problem(key, text) for key, text in settings_problems(written.zenoh, "zenoh")]
        if not written.operator.strip():
            problems.append(Problem("operator", FleetMistake.OPERATOR_MISSING()))
        elif problem := operator_name_problem(written.operator):
            problems.append(Problem("operator", problem))
        if not written.key_file.strip():
            problems.append(Problem("key_file", FleetMistake.KEY_FILE_MISSING()))
    if problems:
        raise SessionError(path, [document.locate(problem) for problem in problems])
    return FleetFile(written.zenoh, written.operator, read_key(key_path(path.parent, written.key_file)), path)
