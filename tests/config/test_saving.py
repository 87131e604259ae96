"""Saving keeps what the operator wrote: comments, order and layout stay; only what changed changes in the text."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from msgspec.structs import replace
from tests.config.call_entries_helpers import called
from tests.config.samples import SAMPLES
from tests.support.long import long_cases
from tests.support.wording import pattern

from rsb_bridge.config.merge import identity, merge
from rsb_bridge.config.session_file import (
    ChangedOnDiskError,
    SavingProblem,
    SessionError,
    UneditableError,
    load,
    load_file,
    parse,
    same,
    save,
)
from rsb_bridge.config.validation import SessionMistake
from rsb_bridge.config.yaml_text import inline, read_yaml
from rsb_bridge.model.qos import PROFILES
from rsb_bridge.model.session import Client, Grant, Session, Topic

HEAD = "name: robot1\nrole: client\nserver_ip: 10.0.0.1\nserver_port: 49152\nkey_file: key.txt\n"


def edited(text: str, folder: Path, change: Callable[[Session], Session]) -> str:
    """Return a file's text after a session from it was changed and saved."""
    path = folder / "robot1.yaml"
    path.write_bytes(text.encode())
    opened = load_file(path)
    session = change(opened.session)
    save(session, path, opened)
    assert same(load(path), session)
    return path.read_bytes().decode()


def files_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def topics(*changes: tuple[int, Topic | dict[str, Any] | None]) -> Callable[[Session], Session]:
    """Edit, remove (None) or add topics by their index."""

    def change(session: Session) -> Session:
        made: list[Topic | None] = list(session.topics)
        for at, new in changes:
            if at == len(made):
                assert isinstance(new, Topic)
                made.append(new)
            else:
                made[at] = replace(session.topics[at], **new) if isinstance(new, dict) else new
        return replace(session, topics=tuple(each for each in made if each is not None))

    return change


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_saving_what_did_not_change_changes_nothing(path: Path, tmp_path: Path) -> None:
    text = path.read_text()
    assert edited(text, tmp_path, lambda session: session) == text


BLOCKS = (
    HEAD
    + """\
topics:
    # the laser
    - topic: /scan          # 40 Hz
      direction: transmit
      # over Wi-Fi, so:
      protocol: udp         # loses some
      qos: sensor_data

    - topic: "/map"
      direction: 'transmit'
      # compression: zstd   (try this)
    # not now:
    # - {topic: /odom, direction: transmit}
# the end
"""
)
FLOWS = (
    HEAD
    + """\
topics:
- {topic: /scan,   direction: transmit,  max_rate: 5}   # the laser
# from the desk
- { topic: /goal, direction: receive }
- {topic: /map,          # large
   direction: transmit,  # seldom
   paused: true}
"""
)
JSON = """\
{"name": "robot1", "role": "client", "server_ip": "10.0.0.1", "server_port": 49152, "key_file": "key.txt",
 "topics": [
   {"topic": "/scan", "direction": "transmit", "paused": true},  # the laser
   {"topic": "/map", "direction": "transmit"}
 ]
}
"""


@pytest.mark.parametrize(
    ("text", "change", "old", "new"),
    [
        pytest.param(
            BLOCKS, topics((0, {"protocol": "tcp"})),
            "      protocol: udp         # loses some\n", "      protocol: tcp         # loses some\n", id="value",
        ),
        pytest.param(BLOCKS, topics((0, {"max_rate": 20.0})),
                     "      qos: sensor_data\n", "      qos: sensor_data\n      max_rate: 20\n", id="new key"),
        pytest.param(
            BLOCKS, topics((0, {"protocol": None})), "      protocol: udp         # loses some\n", "", id="gone"
        ),
        pytest.param(
            BLOCKS, topics((0, None)),
            BLOCKS[BLOCKS.index("    - topic: /scan") : BLOCKS.index("\n    - topic: \"/map")], "", id="removed",
        ),
        pytest.param(
            BLOCKS, topics((1, None)),
            BLOCKS[BLOCKS.index("    - topic: \"/map") : BLOCKS.index("    # not now")], "", id="last removed",
        ),
        pytest.param(
            BLOCKS, topics((1, {"topic": "/map2"})), "- topic: \"/map\"\n", "- topic: \"/map2\"\n", id="renamed",
        ),
        pytest.param(
            BLOCKS, topics((2, Topic("/odom", "transmit", qos={"depth": 3}))), "(try this)\n",
            "(try this)\n\n    - topic: /odom\n      direction: transmit\n      qos: {depth: 3}\n", id="added",
        ),
        pytest.param(
            BLOCKS, topics((0, None), (1, None)), BLOCKS[BLOCKS.index("topics:") : BLOCKS.index("    # not now")],
            "topics: []\n    # the laser\n\n", id="all removed",
        ),
        pytest.param(BLOCKS, lambda session: replace(session, domain_id=3, key_file="no"), "key_file: key.txt\n",
                     "domain_id: 3\nkey_file: 'no'\n", id="top"),
        pytest.param(
            BLOCKS.replace("qos: sensor_data", "qos:  # why\n        depth: 5   # few\n        lifespan: 1.0"),
            topics((0, {"qos": {"depth": 7, "deadline": 0.5}})),
            "        depth: 5   # few\n        lifespan: 1.0\n", "        depth: 7   # few\n        deadline: 0.5\n",
            id="policies",
        ),
        pytest.param(BLOCKS.replace("qos: sensor_data", "qos:\n        depth: 5"), topics((0, {"qos": "latched"})),
                     "qos:\n        depth: 5\n", "qos: latched\n", id="policies to a profile"),
        pytest.param(FLOWS, topics((0, {"max_rate": 7.0, "paused": True})),
                     "max_rate: 5}", "max_rate: 7, paused: true}", id="flow"),
        pytest.param(FLOWS, topics((0, {"max_rate": None})), ",  max_rate: 5}", "}", id="flow, gone"),
        pytest.param(FLOWS, topics((1, None)), "- { topic: /goal, direction: receive }\n", "", id="flow, removed"),
        pytest.param(FLOWS, topics((2, {"paused": False})), "   paused: true}\n", "   }\n", id="flow on lines, gone"),
        pytest.param(FLOWS, topics((3, Topic("/a", "receive"))),
                     "   paused: true}\n", "   paused: true}\n- {topic: /a, direction: receive}\n", id="flow, added"),
        pytest.param(JSON, topics((2, Topic("/a", "receive"))), "\"direction\": \"transmit\"}\n ]",
                     "\"direction\": \"transmit\"},\n   {topic: /a, direction: receive}\n ]", id="JSON, added"),
        pytest.param(JSON, topics((0, {"paused": False})), ", \"paused\": true", "", id="JSON, gone"),
        pytest.param(
            JSON, topics((1, None)), "   {\"topic\": \"/map\", \"direction\": \"transmit\"}\n", "", id="JSON, removed"
        ),
        pytest.param(JSON, lambda session: replace(session, name="r\"1"), '"robot1"', r'"r\"1"', id="JSON, quotes"),
        pytest.param(
            HEAD + "topics: []   # none yet\n", topics((0, Topic("/a", "receive"))), "topics: []   # none yet\n",
            "topics:   # none yet\n  - {topic: /a, direction: receive}\n", id="the first",
        ),
        pytest.param(HEAD, topics((0, Topic("/a", "receive"))), "key_file: key.txt\n",
                     "key_file: key.txt\ntopics:\n  - {topic: /a, direction: receive}\n", id="the first of all"),
        pytest.param(HEAD.rstrip("\n"), topics((0, Topic("/a", "receive"))), "key_file: key.txt",
                     "key_file: key.txt\ntopics:\n  - {topic: /a, direction: receive}", id="no line break at the end"),
        pytest.param(
            HEAD + "domain_id:   # the robot's\n", lambda session: replace(session, domain_id=7),
            "domain_id:   # the robot's\n", "domain_id: 7 # the robot's\n", id="an empty value",
        ),
        pytest.param(
            HEAD + "topics:\n- paused: true\n  # seldom\n  topic: /a\n  direction: receive\n",
            topics((0, {"paused": False})), "- paused: true\n", "-\n", id="the first key goes",
        ),
        pytest.param(HEAD + "topics:\n- paused: true\n  topic: /a\n  direction: receive\n",
                     topics((0, {"paused": False})), "paused: true\n  ", "", id="the next key takes its place"),
        pytest.param("\ufeff" + FLOWS.replace("\n", "\r\n"), topics((3, Topic("/a", "receive"))), "paused: true}\r\n",
                     "paused: true}\r\n- {topic: /a, direction: receive}\r\n", id="as Windows writes it"),
    ],
)  # fmt: skip
def test_only_what_changed_changes(
    tmp_path: Path, text: str, change: Callable[[Session], Session], old: str, new: str
) -> None:
    assert text.count(old) == 1
    assert edited(text, tmp_path, change) == text.replace(old, new)


def test_clients_of_server_keep_their_comments_too(tmp_path: Path) -> None:
    text = next(path for path in SAMPLES if path.stem == "control-pc").read_text()

    def change(session: Session) -> Session:
        one, _, visitor = session.listed_clients
        return replace(session, clients=(one, replace(visitor, allow=(), deny=("/camera/raw", "/b")), Client("robot3")))

    with pytest.raises(SessionError, match=pattern(SessionMistake.KEY_FILE_MISSING)):
        edited(text, tmp_path, change)
    now = edited(text, tmp_path, lambda session: replace(change(session), key_file="all.key"))
    removed = "  - {name: robot2, key_file: robot2.key}\n"
    expected = text.replace(removed, "").replace("[/camera/*]", "[]").replace("[/camera/raw]", "[/camera/raw, /b]")
    assert now == expected.replace("clients:", "key_file: all.key\nclients:") + "  - name: robot3\n"


@pytest.mark.parametrize("text", ["? topics\n: - {topic: /a, direction: receive}\n", "? domain_id\n: 3\n"])
def test_uneditable_layout_is_left_alone(tmp_path: Path, text: str) -> None:
    with pytest.raises(UneditableError, match=pattern(SavingProblem.LAYOUT)):
        edited(HEAD + text, tmp_path, lambda session: replace(session, topics=(), domain_id=None))
    assert (tmp_path / "robot1.yaml").read_text() == HEAD + text
    assert files_in(tmp_path) == ["robot1.yaml"]


def test_what_a_file_said_before_is_kept_once(tmp_path: Path) -> None:
    path, backup = tmp_path / "robot1.yaml", tmp_path / "robot1.yaml~"
    path.write_text(HEAD)
    opened = load_file(path)
    opened = save(opened.session, path, opened)
    assert not backup.exists(), "nothing changed"
    opened = save(replace(opened.session, domain_id=1), path, opened)
    assert backup.read_text() == HEAD
    before = path.read_text()
    save(replace(opened.session, domain_id=2), path, opened)
    assert backup.read_text() == before
    assert files_in(tmp_path) == ["robot1.yaml", "robot1.yaml~"]


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664])
def test_file_keeps_mode_new_one_is_private(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "robot1.yaml"
    save(parse(HEAD, path), path)
    assert path.stat().st_mode & 0o777 == 0o600
    path.chmod(mode)
    opened = load_file(path)
    save(replace(opened.session, domain_id=1), path, opened)
    assert [each.stat().st_mode & 0o777 for each in (path, tmp_path / "robot1.yaml~")] == [mode, mode]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
def test_a_file_keeps_its_owner(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(HEAD)
    os.chown(path, 1234, 5678)
    save(replace(parse(HEAD, path), domain_id=1), path)
    assert (path.stat().st_uid, path.stat().st_gid) == (1234, 5678)


def test_read_only_file_is_refused_with_remedy(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(HEAD)
    path.chmod(0o444)
    opened = load_file(path)
    with pytest.raises(SessionError, match=pattern(SavingProblem.READ_ONLY)):
        save(replace(opened.session, domain_id=1), path, opened)
    assert path.read_text() == HEAD
    assert files_in(tmp_path) == ["robot1.yaml"]


SERVER = """\
name: control
role: server
server_ip: 0.0.0.0
server_port: 49152
key_file: all.key
clients:
  - name: robot1
    topics:              # for the survey
      # seldom
      - {topic: /map, direction: transmit}   # large
      - topic: /goal
        direction: receive
  - {name: robot2, deny: [/camera/*]}        # slow
"""


@pytest.mark.parametrize(
    ("change", "old", "new"),
    [
        pytest.param(lambda one, two: (replace(one, topics=(*one.topics, Topic("/a", "transmit"))), two),
                     "        direction: receive\n",
                     "        direction: receive\n      - topic: /a\n        direction: transmit\n", id="added"),
        pytest.param(lambda one, two: (replace(one, topics=(replace(one.topics[0], max_rate=1.0), one.topics[1])), two),
                     "direction: transmit}", "direction: transmit, max_rate: 1}", id="edited"),
        pytest.param(lambda one, two: (replace(one, topics=one.topics[:1]), two),
                     "      - topic: /goal\n        direction: receive\n", "", id="removed"),
        pytest.param(
            lambda one, two: (one, replace(two, topics=(Topic("/a", "transmit"),))),
            "[/camera/*]}", "[/camera/*], topics: [{topic: /a, direction: transmit}]}", id="the first, in braces",
        ),
    ],
)  # fmt: skip
def test_what_server_proposes_is_kept_under_client(
    tmp_path: Path, change: Callable[[Client, Client], tuple[Client, ...]], old: str, new: str
) -> None:
    now = edited(SERVER, tmp_path, lambda session: replace(session, clients=change(*session.listed_clients)))
    assert now == SERVER.replace(old, new)


@dataclass
class Written:
    """A file during its edits: its lines, each with its entry.

    An owner is a key of the session, or an entry's number, or that and a key. A line changes only when one of its
    owners does; a line without any never does.
    """

    lines: list[tuple[str, frozenset[Any]]] = field(default_factory=list)

    def add(self, line: str, *owners: Any) -> None:
        self.lines.append((line, frozenset(owners)))


@st.composite
def written(draw: st.DrawFn, session: Session) -> Written:  # noqa: PLR0915 -- one file, top to bottom
    """A file that says a session, as somebody could have written it."""
    counter = iter(range(10_000))
    made = Written()
    entries = session.topics or session.listed_clients

    def comment() -> str:
        return draw(st.sampled_from(["", "", f" # c{next(counter)}", f"     #c{next(counter)}: - {{x}} 'y' \"z"]))

    def between(indent: int, *owners: Any) -> None:
        for _ in range(draw(st.sampled_from([0, 0, 0, 1, 2]))):
            blank = draw(st.booleans())
            made.add("" if blank else f"{' ' * indent}# own line {next(counter)}", *owners)

    def scalar(value: Any) -> str:
        if isinstance(value, str) and value.isascii() and draw(st.booleans()):
            return (
                draw(st.sampled_from([f'"{value}"', f"'{value}'"]))
                if re.fullmatch(r"[\w/.*-]*", value)
                else inline(value)
            )
        return inline(value)

    def flow(items: list[tuple[str, Any]]) -> str:
        gap = draw(st.sampled_from([", ", ",", ",   "]))
        colon = ": "
        pairs = gap.join(f"{key}{colon}{scalar(value)}" for key, value in items)
        return draw(st.sampled_from([f"{{{pairs}}}", f"{{ {pairs} }}", f"{{{pairs},}}"]))

    def shuffled(struct: msgspec.Struct) -> list[tuple[str, Any]]:
        return draw(st.permutations(list(msgspec.to_builtins(struct).items())))

    def on_lines(at: int, each: msgspec.Struct, lead: str, end: str, *owners: Any) -> None:
        """In braces, with a line for each key; or two, where the comma leads."""
        items, comma_leads = shuffled(each), draw(st.booleans())
        for number, (key, value) in enumerate(items):
            last = number == len(items) - 1
            start = (lead if not number else " " * len(lead)) + ("{" if not number else ", " if comma_leads else " ")
            comma = "" if comma_leads else "," if not last or draw(st.booleans()) else ""
            made.add(f"{start}{key}: {scalar(value)}{comma}{comment()}", at, (at, key), (at, "in braces"), *owners)
        made.add(f"{' ' * len(lead)}}}{end}{comment()}", at, (at, "in braces"), *owners)

    def nested_topics(topics: list[dict[str, Any]], head: str, indent: int, *owners: Any) -> None:
        made.add(f"{head}{comment()}", *owners)
        for topic in topics:
            if draw(st.booleans()):
                made.add(f"{' ' * indent}- {inline(topic)}{comment()}", *owners)
                continue
            for number, (key, value) in enumerate(topic.items()):
                made.add(f"{' ' * indent}{' ' if number else '-'} {key}: {inline(value)}{comment()}", *owners)

    def entry(at: int, each: msgspec.Struct, indent: int, style: str) -> None:
        items = shuffled(each)
        if style == "lines":
            on_lines(at, each, " " * indent + "- ", "")
            return
        if style == "flow":
            made.add(f"{' ' * indent}- {flow(items)}{comment()}", at, (at, "in braces"))
            return
        offset = draw(st.sampled_from([2, 2, 4]))
        for number, (key, value) in enumerate(items):
            lead = " " * indent + ("-" + " " * (offset - 1) if not number else " " * offset)
            owners = (at, (at, key), *(((at, "first"),) if not number else ()))
            if isinstance(value, dict) and value and draw(st.booleans()):
                made.add(f"{lead}{key}:", *owners)
                for policy, what in value.items():
                    made.add(f"{' ' * (indent + offset + 1)}{policy}: {inline(what)}{comment()}", *owners)
            elif key == "topics" and draw(st.booleans()):
                nested_topics(value, f"{lead}{key}:", indent + offset + draw(st.sampled_from([0, 2])), *owners)
            else:
                made.add(f"{lead}{key}: {scalar(value)}{comment()}", *owners)
            between(indent + offset, at, (at, "inside"))

    if draw(st.booleans()):
        made.add("--- # start")
    between(0)
    for key, value in shuffled(session):
        if key not in ("topics", "clients"):
            made.add(f"{key}: {scalar(value)}{comment()}", key)
            between(draw(st.sampled_from([0, 2])))
            continue
        if not entries:  # a server's without clients, for now: a key without a value would be refused
            made.add(f"{key}: []{comment()}", "the list")
            continue
        indent = draw(st.sampled_from([0, 2, 4]))
        style = draw(st.sampled_from(["flow", "block", "lines", "mixed", "brackets"]))
        if style == "brackets":
            made.add(f"{key}: [{comment()}", "the list")
            for at, each in enumerate(entries):
                between(indent)
                end = "," if at < len(entries) - 1 or draw(st.booleans()) else ""
                if draw(st.booleans()):
                    on_lines(at, each, "   ", end, "in brackets")
                else:
                    made.add(f"   {flow(shuffled(each))}{end}{comment()}", at, (at, "in braces"), "in brackets")
            made.add(f" ]{comment()}")
            continue
        made.add(f"{key}:{comment()}", "the list")
        for at, each in enumerate(entries):
            between(indent)
            entry(at, each, indent, draw(st.sampled_from(["flow", "block", "lines"])) if style == "mixed" else style)
    between(0)
    return made


names = st.text("ab_", min_size=1, max_size=5).map("/{}".format)
policies = st.fixed_dictionaries({"depth": st.integers(1, 9)}, optional={"profile": st.sampled_from(list(PROFILES)),
    "deadline": st.sampled_from([0.5, 2.0])})  # fmt: skip
fields_of_a_topic = {
    "type": st.sampled_from(["auto", "LaserScan", "my_msgs/msg/Thing2"]),
    "protocol": st.sampled_from([None, "tcp", "udp"]),
    "qos": st.one_of(st.sampled_from(["auto", "latched"]), st.integers(1, 9), policies),
    "remote_topic": st.none() | names,
    "max_rate": st.none() | st.floats(0.5, 99),
    "stale_after": st.sampled_from([None, 0.0, 3.0]),
    "paused": st.booleans(),
}
grants = st.builds(
    Grant, topics=names, may=st.sampled_from(["publish", "read"]), protocol=st.sampled_from([None, "udp"])
)
patterns = st.lists(names | grants, max_size=3, unique=True).map(tuple)
some_topics = st.builds(Topic, topic=names, direction=st.sampled_from(["transmit", "receive"]), **fields_of_a_topic)
fields_of_a_client = {
    "topics": st.lists(some_topics, max_size=3, unique_by=(identity, called)).map(tuple),
    "key_file": st.sampled_from([None, "a.key", "no", "b: c"]),
    "use_name": st.sampled_from([None, False]),
    "allow": patterns,
    "deny": patterns,
}
some_clients = st.builds(
    Client, name=st.text("abz1- #:", min_size=1).map(lambda text: f"x{text}x"), **fields_of_a_client
)
fields_of_a_session = {
    "name": st.sampled_from(["robot1", "no", "12:30", "ü # x", "a\"b'c"]),
    "domain_id": st.none() | st.integers(0, 9),
    "key_file": st.sampled_from(["key.txt", "../a b.key", "~/k#1"]),
    "stale_after": st.sampled_from([15.0, 0.0, 7.5]),
    "shutdown_topic": st.sampled_from(["/shutdown", None, "/stop"]),
}
clients_sessions = st.builds(
    Session, role=st.just("client"), server_ip=st.just("10.0.0.1"), server_port=st.integers(2000, 2009),
    topics=st.lists(some_topics, max_size=5, unique_by=(identity, called)).map(tuple),
    allow=patterns, deny=patterns, **fields_of_a_session,
)  # fmt: skip
servers_sessions = st.builds(
    Session, role=st.just("server"), server_ip=st.just("::"), server_port=st.integers(2000, 2009),
    clients=st.lists(some_clients, max_size=4, unique_by=lambda each: each.name).map(tuple),
    **fields_of_a_session,
)  # fmt: skip


@st.composite
def changed(draw: st.DrawFn, session: Session) -> tuple[Session, set[Any]]:
    """A session after an operator's edits, and the owners of the lines that may change."""
    kinds: tuple[Any, Any] = (
        (fields_of_a_topic, some_topics) if session.role == "client" else (fields_of_a_client, some_clients)
    )
    which = "topics" if session.role == "client" else "clients"
    entries, owners, made = getattr(session, which), set[Any](), list[Topic | Client]()
    for at, each in enumerate(entries):
        match draw(st.sampled_from(["stays", "stays", "edited", "removed"])):
            case "stays":
                made.append(each)
            case "edited":
                keys = draw(st.sets(st.sampled_from(list(kinds[0])), max_size=3))
                new = replace(each, **{key: draw(kinds[0][key]) for key in sorted(keys)})
                made.append(new)
                owners |= {(at, key) for key in keys if getattr(new, key) != getattr(each, key)}
            case "removed":
                owners |= {at}
    taken = {identity(each) for each in entries}
    new = draw(st.lists(kinds[1], max_size=2, unique_by=identity))
    made += [each for each in new if identity(each) not in taken]
    keys = draw(st.sets(st.sampled_from(list(fields_of_a_session)), max_size=2))
    values = {key: draw(fields_of_a_session[key]) for key in sorted(keys)}
    if all(at in owners for at in range(len(entries))):
        owners |= {"the list"}
    owners |= {key for key, value in values.items() if value != getattr(session, key)}
    return replace(session, **{which: tuple(made)}, **values), owners


def kept(file: Written, owners: set[Any]) -> Iterator[tuple[str, bool]]:
    """The lines that have to stay; with each, whether it may take the place behind the dash of a line that goes.

    An edit may rewrite the lines of an entry in braces, and may put a comma behind an entry in brackets.
    """
    edited_entries = {owner[0] for owner in owners if isinstance(owner, tuple)}
    headless = {at for at in edited_entries for _, whose in file.lines if (at, "first") in whose and whose & owners}
    for line, whose in file.lines:
        at = next((owner for owner in whose if isinstance(owner, int)), None)
        if at in headless and not line.strip():
            continue  # blank lines go with the first key
        in_braces = (at, "in braces") in whose
        if not whose & owners and not (at in edited_entries and in_braces) and "in brackets" not in whose:
            yield line, at in headless


@pytest.mark.parametrize(
    ("sessions", "line_break"),
    [
        (clients_sessions, "\r\n"),
        (servers_sessions, "\n"),
        *long_cases((clients_sessions, "\n"), (servers_sessions, "\r\n")),
    ],
    ids=["client-crlf", "server-lf", "client-lf", "server-crlf"],
)
@given(data=st.data())
def test_a_save_is_a_merge(sessions: st.SearchStrategy[Session], line_break: str, data: st.DataObject) -> None:
    """For any file and any edits: unchanged lines stay as they were, and loading gives the session."""
    session = data.draw(sessions)
    file = data.draw(written(session))
    text = line_break.join(line for line, _ in file.lines) + data.draw(st.sampled_from([line_break, ""]))
    path = Path("robot1.yaml")
    assert parse(text, path) == session
    now, owners = data.draw(changed(session))
    for topics in (now.topics, *(client.topics for client in now.listed_clients)):
        assume(len({called(topic) for topic in topics}) == len(topics))
    result = merged(text, now)
    assert same(parse(result, path), now), result
    lines = iter(re.split(r"\r?\n", result))
    for line, moves in kept(file, owners):
        same_line = (each == line or (moves and each.lstrip(" -") == line.lstrip(" -")) for each in lines)
        assert any(same_line), f"{line!r} is lost, or in another place:\n{result}"
    stay = [line for line, whose in file.lines if not whose & owners]
    for comment in re.findall(r"# ?(?:own line |c)\d+.*", "\n".join(stay)):
        assert comment in result, f"{comment!r} is lost:\n{result}"
    if line_break == "\r\n":
        assert "\n" not in result.replace("\r\n", "")
    if now == session:
        assert result == text


def merged(text: str, session: Session) -> str:
    path = Path("robot1.yaml")
    return merge(text, read_yaml(text, path).root, parse(text, path), session)


def test_file_changed_on_disk_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(FLOWS)
    opened = load_file(path)
    path.write_text(FLOWS.replace("/goal", "/aim"))
    now = replace(opened.session, domain_id=3)
    with pytest.raises(ChangedOnDiskError, match=pattern(SavingProblem.CHANGED)):
        save(now, path, opened)
    assert path.read_text() == FLOWS.replace("/goal", "/aim")
    saved = save(now, tmp_path / "other.yaml", opened)
    assert "# the laser" in saved.text == (tmp_path / "other.yaml").read_text(), "under another name comments go along"
    save(replace(now, domain_id=4), tmp_path / "other.yaml", saved)
    assert load(tmp_path / "other.yaml").domain_id == 4


def test_a_file_that_is_gone_is_written_again(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(FLOWS)
    opened = load_file(path)
    path.unlink()
    save(opened.session, path, opened)
    assert path.read_text() == FLOWS
    assert path.stat().st_mode & 0o777 == 0o600
