"""Session files and keys: what an operator wrote, or was sent by mail."""

from __future__ import annotations

from pathlib import Path

import msgspec
from tests.fuzz.editing import edit_text
from tests.fuzz.parser import Parser
from tests.fuzz.scratch import scratch_folder

from rsb_bridge.config.keys import KEY_BYTES, KeyFileError, generate, is_key, is_key_file, read_key
from rsb_bridge.config.session_file import (
    SessionError,
    SessionFile,
    UneditableError,
    dump,
    edited_text,
    load_file,
    parse,
    same,
)
from rsb_bridge.model.session import Session, Topic

_CONFIGS = Path(__file__).parents[3] / "configs"
_KEY = generate()


def file_of(data: bytes) -> Path:
    path = scratch_folder() / "robot1.yaml"
    path.write_bytes(data)
    return path


def check_problems(error: SessionError) -> None:
    assert error.problems
    for problem in error.problems:
        assert problem.message
        assert len(problem.message) <= 2000, "a problem quotes without end"
        assert problem.line is None or problem.line >= 1


def check_session(session: Session, path: Path) -> None:
    assert same(parse(dump(session), path), session)


def _read_session(data: bytes) -> None:
    """Check that a session that is read can be written, and edited in place."""
    path = file_of(data)
    try:
        opened = load_file(path)
    except SessionError as error:
        check_problems(error)
        return
    check_session(opened.session, path)
    _edit(opened)


def _edit(opened: SessionFile) -> None:
    session = opened.session
    if session.role != "client":
        return
    topics = (*session.topics[1:], Topic("/fuzzed_topic", "transmit"))
    try:
        edited_text(msgspec.structs.replace(session, topics=topics), opened.path, opened)
    except UneditableError:
        pass  # reported to the operator, who may write the whole file again
    except SessionError as error:
        check_problems(error)


def _read_key(data: bytes) -> None:
    try:
        key = read_key(file_of(data))
    except KeyFileError as error:
        problem = str(error)
    else:
        assert len(key.secret) == KEY_BYTES
        problem = repr(key)
    assert not any(is_key(word) for word in problem.split()), "a message gives a key away"
    text = data.decode(errors="replace")
    assert not is_key(text) or is_key_file(text)


PARSERS = (
    Parser(
        "session_file", _read_session, tuple(path.read_bytes() for path in sorted(_CONFIGS.glob("*.yaml"))), edit_text
    ),
    Parser("key_file", _read_key, (_KEY, b"2021-03-04 12:00:00\n" + _KEY + b"\n", _KEY[:-1])),
)
