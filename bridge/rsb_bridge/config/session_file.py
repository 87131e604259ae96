"""Session files: reading them, with the line of every mistake, and saving them."""

from __future__ import annotations

import errno
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.config.decoding import join
from rsb_bridge.config.file_form import as_plain, as_written, locations
from rsb_bridge.config.files import replace_file, stat_of, why_not_written
from rsb_bridge.config.folder_owner import acting_in_folder
from rsb_bridge.config.imports.other_bridges import origin_of
from rsb_bridge.config.validation import build, placed, validate, validate_topic
from rsb_bridge.config.yaml_text import SessionError, dump_yaml, read_text, read_yaml, text_if_there
from rsb_bridge.model.demands import SourceKey, armed_line, sources_of_entries, sources_of_names
from rsb_bridge.model.session import Problem, Session, Topic
from rsb_bridge.model.text import one_line
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.model.session import Identity

__all__ = ["Problem", "SessionError", "dump", "load", "parse", "save", "validate", "validate_topic"]

_NO_DOMAIN = "# domain_id: 0   # without it, $ROS_DOMAIN_ID of this side, else 0\n"


class SavingProblem(Wording):
    """The reason why a session file cannot be read as such, or be saved."""

    CHANGED = "was changed on disk: `rsb-console reload` takes the file, w in a console compares and asks"
    FOREIGN = "this is a file of {origin}: convert it with `rsb-console import {path}`"
    NOT_WRITTEN = "cannot be written: {problem}"
    READ_ONLY = "it is read-only: run `chmod u+w {path}` to save it"
    LAYOUT = "its layout cannot be edited in place: w in a console saves it anew, or under another name"


class ChangedOnDiskError(SessionError):
    """The file was changed by somebody else since it was opened."""


class UnwritableError(SessionError):
    """The file cannot be written, for a reason outside of its contents."""


class UneditableError(SessionError):
    """A change cannot be put into the text of a file; the file can only be replaced, without its comments."""


@dataclass(frozen=True, slots=True)
class SessionFile:
    path: Path
    text: str
    session: Session

    def is_at(self, path: Path) -> bool:
        return path.resolve() == self.path.resolve()

    def check_unchanged(self) -> None:
        """Raise ChangedOnDiskError if another text is on disk by now; a file that is gone is no change."""
        if text_if_there(self.path) not in (None, self.text):
            raise ChangedOnDiskError(self.path, [Problem("", SavingProblem.CHANGED())])


# --- reading. All functions raise a SessionError that has all mistakes of the file


def load(path: Path) -> Session:
    return load_file(path).session


def load_file(path: Path) -> SessionFile:
    """Read a session file, and keep the text, so that the session can be saved with changes."""
    text = read_text(path)
    return SessionFile(path, text, parse(text, path))


def open_file(path: Path) -> SessionFile | None:
    """Open a session file as it is on disk now, or return None if it is missing or has mistakes."""
    try:
        return load_file(path)
    except SessionError:
        return None


def parse(text: str, path: Path) -> Session:
    """Read a session from the text of the file at a path."""
    document = read_yaml(text, path)
    if origin := origin_of(document.data):
        raise SessionError(path, [Problem("", SavingProblem.FOREIGN(origin=origin.value, path=path))])
    session, problems = build(document.data)
    if document.problems or problems:
        in_text = [placed(problem, document.data) for problem in document.problems]
        raise SessionError(path, in_text + [document.locate(problem) for problem in problems])
    return session


def demand_places(path: Path) -> dict[SourceKey, str]:
    """Return where a session file demands arming or limits (``robot.yaml:14``); one with mistakes has no such lines."""
    try:
        found = demand_lines(read_text(path), path)
    except SessionError:
        return {}
    return {key: ", ".join(f"{path.name}:{line}" for line in lines) for key, lines in found.items()}


def demand_lines(text: str, path: Path) -> dict[SourceKey, list[int]]:
    """Return the lines of a session file's text that demand arming or limits, by the keys of what they demand."""
    session, lines = parse(text, path), read_yaml(text, path).lines
    found: dict[SourceKey, list[int]] = {}
    for at, source in enumerate(sources_of_names(session.armed)):
        found.setdefault(source.key, []).append(lines[join("armed", at)])
    holders = [("", session.name, False, False, session.topics)]
    for at, each in enumerate(session.listed_clients):
        holders.append((join("clients", at), each.name, True, each.is_prefixed(session), each.topics))
    for where, client, on_server, use_name, topics in holders:
        for topic, here in zip(topics, locations(topics), strict=True):
            if topic.arm or topic.limits is not None:
                (source,) = sources_of_entries([topic], client, on_server=on_server, use_name=use_name)
                key = armed_line(source).key if topic.arm else source.key
                found.setdefault(key, []).append(lines[join(join(where, here), "arm" if topic.arm else "limits")])
    return found


# --- saving


def dump(session: Session, notes: Iterable[str] = ()) -> str:
    """Return the text of a new session file, without the values that are at their defaults.

    A comment names the domain that it does not give.

    Args:
        notes: comments at its head, one line each.
    """
    head = "".join(f"# {one_line(note)}\n" for note in notes)
    return head + dump_yaml(as_plain(as_written(session))) + (_NO_DOMAIN if session.domain_id is None else "")


def same(one: Session, other: Session) -> bool:
    """Whether two sessions differ in nothing but the order of topics and clients, which a merge leaves as it is."""

    def ordered(topics: tuple[Topic, ...]) -> tuple[Topic, ...]:
        return tuple(sorted(topics, key=lambda topic: topic.identity))

    def in_order(session: Session) -> Session:
        clients = sorted(session.listed_clients, key=lambda client: client.name)
        listed = tuple(msgspec.structs.replace(each, topics=ordered(each.topics)) for each in clients)
        clients_of = None if session.clients is None else listed
        return msgspec.structs.replace(session, topics=ordered(session.topics), clients=clients_of)

    return in_order(one) == in_order(other)


class SessionInFile:
    """A session file's contents, next to the running session.

    Attributes:
        session: of the file, or None without a file.
        name: of the file, without its folder.
    """

    def __init__(self) -> None:
        self.session: Session | None = None
        self.name = ""
        self._compared: tuple[Session | None, Session | None] = None, None
        self._differs = False
        self._placed: Session | None = None
        self._places: dict[tuple[str, Identity], str] = {}

    def differs(self, running: Session) -> bool:
        """Whether the running session is not the file's. Cheap while neither changes: every snapshot asks."""
        held, compared = self._compared
        if self.session is None or self.session is not held or running != compared:
            self._compared = self.session, running
            self._differs = self.session is not None and not same(self.session, running)
        return self._differs

    def place(self, client: str, identity: Identity) -> str:
        """Return where the file lists an entry: ``topics[2] of robot1.yaml``, or an empty string if it does not.

        Args:
            client: on a server, the client that the entry is for, or an empty string.
        """
        if self.session is not self._placed:  # a link asks for each of a thousand topics
            self._placed, self._places = self.session, {}
            holders = [] if self.session is None else [("", "", self.session.topics)]
            for at, each in enumerate([] if self.session is None else self.session.listed_clients):
                holders.append((each.name, join("clients", at), each.topics))
            for name, where, topics in holders:
                for topic, here in zip(topics, locations(topics), strict=True):
                    self._places[name, topic.identity] = f"{join(where, here)} of {self.name}"
        return self._places.get((client, identity), "")


def save(session: Session, path: Path, opened: SessionFile | None = None, notes: Iterable[str] = ()) -> SessionFile:
    """Write a session file as `edited_text` has it, whole or not at all, and return it as it is now.

    A file that is replaced keeps its mode, owner and group, and its previous contents are kept in `backup_path`. A new
    file has mode 0600.

    Raises:
        ChangedOnDiskError: the file was changed on disk since it was opened.
        UnwritableError: it cannot be written.
        SessionError: the session has mistakes. In all cases the old file is as it was.
    """
    text = edited_text(session, path, opened, notes)
    content = text.encode()
    if opened is not None and opened.is_at(path):
        opened.check_unchanged()
    try:
        # The backup, too, is a copy of what that folder's owner may read, and of nothing else.
        with acting_in_folder(path):
            # Its folder's rights would let a file without any right to write be replaced.
            status = stat_of(path)
            if status is not None and not stat.S_IMODE(status.st_mode) & (stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH):
                raise PermissionError(errno.EACCES, SavingProblem.READ_ONLY(path=path))
            # A second save of the same text must not replace the backup, the only copy of the earlier contents.
            if status is not None and stat.S_ISREG(status.st_mode) and (before := path.read_bytes()) != content:
                replace_file(backup_path(path), before, like=path)
            replace_file(path, content, like=path)
    except OSError as error:
        message = SavingProblem.NOT_WRITTEN(problem=why_not_written(error, path))
        raise UnwritableError(path, [Problem("", message)]) from None
    return SessionFile(path, text, session)


def edited_text(session: Session, path: Path, opened: SessionFile | None = None, notes: Iterable[str] = ()) -> str:
    """Return the text that `save` writes.

    Args:
        opened: the file that the session came from, or None for a new text. Comments, order, layout and all values that
            did not change are kept.
        notes: as in `dump`, of a new text.

    Raises:
        UneditableError: the changes cannot be put into the opened file's text.
        SessionError: the session has mistakes.
    """
    from rsb_bridge.config.merge import LayoutError, merge  # noqa: PLC0415 -- only saving needs it

    if problems := validate(session):
        raise SessionError(path, problems)
    where = path if opened is None else opened.path
    try:
        if opened is None:
            text = dump(session, notes)
        else:
            text = merge(opened.text, read_yaml(opened.text, where).root, opened.session, session)
        if same(parse(text, where), session):  # a mistake of the merge must not reach the file
            return text
    except (LayoutError, SessionError):
        pass
    if opened is not None:
        raise UneditableError(where, [Problem("", SavingProblem.LAYOUT())])
    raise SessionError(path, [Problem("", "not saved: the file would not load again as this session")])


def backup_path(path: Path) -> Path:
    """Return the path of the previous contents of a session file: the same name with a ``~`` at the end."""
    target = Path(os.path.realpath(path))
    return target.with_name(f"{target.name}~")
