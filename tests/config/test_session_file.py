"""A session that is saved loads again as it was, and a failing save leaves the old file."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_full_topic_name import validate_full_topic_name
from tests.config.call_entries_helpers import called
from tests.support.wording import pattern

from rsb_bridge.config.files import FileRefused
from rsb_bridge.config.keys import KeyFileError, KeyFileProblem, write_key
from rsb_bridge.config.session_file import (
    SavingProblem,
    SessionError,
    dump,
    load,
    parse,
    save,
    validate,
    validate_topic,
)
from rsb_bridge.config.validation import SessionMistake
from rsb_bridge.model.qos import PROFILES
from rsb_bridge.model.session import Client, Session, Topic
from rsb_bridge.model.text import is_clean

FILE = Path("robot1.yaml")
SESSION = Session(name="robot1", role="client", server_ip="127.0.0.1", server_port=49152, key_file="key.txt")

words = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), min_size=1, max_size=20).filter(is_clean)
names = st.one_of(words, st.sampled_from(["no", "1e5", "12:30:45", "null", "~", "0x1F", "- a", "*a", "a: b", "'", '"']))
topic_names = st.from_regex(r"(/[A-Za-z_][A-Za-z0-9_]{0,5}){1,3}", fullmatch=True)
rates = st.none() | st.floats(min_value=0.001, max_value=1e6)
waits = st.just(0.0) | st.floats(min_value=0.1, max_value=1e6)
macs = st.from_regex(r"[0-9A-F]{2}(:[0-9A-F]{2}){5}", fullmatch=True).filter(lambda mac: mac != "00:00:00:00:00:00")
qos = st.one_of(
    st.sampled_from(["auto", *PROFILES]),
    st.integers(1, 1000),
    st.fixed_dictionaries({}, optional={"profile": st.sampled_from(list(PROFILES)), "depth": st.integers(1, 99)}),
)
topics = st.builds(
    Topic, topic=topic_names, direction=st.sampled_from(["transmit", "receive"]),
    type=st.sampled_from(["auto", "LaserScan", "nav_msgs/Odometry", "my_msgs/msg/Thing2"]), qos=qos,
    remote_topic=st.none() | topic_names, compression=st.sampled_from([None, "none", "zstd"]), max_rate=rates,
    expected_rate=rates, stale_after=st.none() | waits, paused=st.booleans(), arm=st.just(True),
    deadman=st.none() | st.just(0.0) | st.floats(2, 86_400),
)  # fmt: skip
patterns = st.lists(topic_names.map(lambda name: f"{name}/*"), max_size=2).map(tuple)
next_key_files = st.none() | names.map("{}.next".format)
allowed = st.builds(
    Client, name=names, key_file=st.none() | names, next_key_file=next_key_files, use_name=st.just(False),
    allow=patterns, deny=patterns,
)  # fmt: skip
common = {
    "name": names,
    "domain_id": st.none() | st.integers(0, 232),
    "key_file": names,
    "use_encryption": st.booleans(),
    "check_messages": st.booleans(),
    "stale_after": waits,
    "stale_warnings": st.integers(0, 99),
    "shutdown_topic": st.none() | topic_names,
}
hosts = st.sampled_from(["10.0.0.1", "fe80::1%eth0", "robot-1.local"])
sessions = st.one_of(
    st.builds(
        Session, role=st.just("client"), server_ip=hosts | st.lists(hosts, min_size=1, unique=True).map(tuple),
        server_port=st.integers(1, 65535),
        topics=st.lists(topics, max_size=5, unique_by=(lambda topic: topic.identity, called)).map(tuple), **common,
    ),
    st.builds(Session, role=st.just("client"), server_ip=macs, server_port=st.integers(1, 30), **common),
    st.builds(
        Session, role=st.just("server"), server_ip=st.sampled_from(["0.0.0.0", "::"]),
        server_port=st.integers(1, 65535), next_key_file=next_key_files, shared_keys=st.booleans(),
        ports=st.none() | st.just("none") | st.lists(st.integers(1024, 65535), max_size=3).map(tuple),
        clients=st.lists(allowed, max_size=3, unique_by=lambda client: client.name).map(tuple), **common,
    ),
)  # fmt: skip


@given(sessions)
def test_a_session_loads_again_as_it_was(session: Session) -> None:
    assert validate(session) == []
    text = dump(session)
    assert parse(text, FILE) == session
    assert yaml.safe_load(text)["name"] == session.name  # YAML 1.1 readers see the same


@given(st.text("/aZ_09-~é ", max_size=12) | st.text("a", min_size=240, max_size=250).map("/{}".format))
def test_topic_names_are_judged_as_ros_judges_them(name: str) -> None:
    try:
        right = validate_full_topic_name(name)
    except InvalidTopicNameException:
        right = False
    assert (validate_topic(Topic(topic=name, direction="transmit")) == []) == right


def test_saving_keeps_the_mode_and_follows_a_link(tmp_path: Path) -> None:
    target = tmp_path / "sessions" / "robot1.yaml"
    target.parent.mkdir()
    target.write_text("old")
    target.chmod(0o644)
    link = tmp_path / "link.yaml"
    link.symlink_to(target)
    save(SESSION, link)
    assert load(target) == SESSION
    assert link.is_symlink()
    assert target.stat().st_mode & 0o777 == 0o644
    assert sorted(target.parent.iterdir()) == [target, target.with_name("robot1.yaml~")]


def test_a_session_with_mistakes_is_not_saved(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    save(SESSION, path)
    bad = Session(name="robot1", role="client", server_ip="127.0.0.1", server_port=0, key_file="key.txt")
    with pytest.raises(SessionError, match=pattern(SessionMistake.PORT_MISSING)):
        save(bad, path)
    assert load(path) == SESSION


@pytest.mark.parametrize("name", ["fifo", "link", "folder"])
def test_only_files_are_replaced(tmp_path: Path, name: str) -> None:
    """Here a FIFO, a link to one, and a folder; a device node, like /dev/null, is refused by the same rule."""
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "link").symlink_to(tmp_path / "fifo")
    (tmp_path / "folder").mkdir()
    before = {path: path.lstat().st_ino for path in tmp_path.iterdir()}
    problem = FileRefused.NOT_A_FILE(kind="a folder" if name == "folder" else "a FIFO")
    with pytest.raises(SessionError, match=pattern(SavingProblem.NOT_WRITTEN, problem=problem)):
        save(SESSION, tmp_path / name)
    with pytest.raises(KeyFileError, match=pattern(KeyFileProblem.NOT_WRITTEN, problem=problem)):
        write_key(tmp_path / name, force=True)
    assert {path: path.lstat().st_ino for path in tmp_path.iterdir()} == before


def test_a_full_disk_leaves_the_old_file(tmp_path: Path) -> None:
    """A limit on file size, in a process of its own, replaces the full disk: the same write fails."""
    path = tmp_path / "robot1.yaml"
    save(SESSION, path)
    script = (
        "import resource; from pathlib import Path; from rsb_bridge.config.session_file import *\n"
        f"path = Path({str(path)!r}); session = load(path)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (16, 16))\n"
        "try: save(session, path)\n"
        "except SessionError as error: print(error)\n"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=120)
    assert run.stdout.startswith(f"{path}: cannot be written: File too large: ")
    assert load(path) == SESSION
    assert list(tmp_path.iterdir()) == [path]


def test_readers_and_kill_see_one_whole_session(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    save(SESSION, path)
    script = (
        "from pathlib import Path\n"
        "from rsb_bridge.model.session import *; from rsb_bridge.config.session_file import *\n"
        f"path = Path({str(path)!r}); one = load(path)\n"
        "topics = tuple(Topic(topic=f'/t{n}', direction='transmit') for n in range(100))\n"
        "other = Session(name='robot1', role='client', server_ip='::1', server_port=1, key_file='k', topics=topics)\n"
        "print('ready', flush=True)\n"
        "while True: save(other, path); save(one, path)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as saver:
        assert saver.stdout
        assert saver.stdout.readline() == b"ready\n"
        seen = {len(load(path).topics) for _ in range(60)}
        os.kill(saver.pid, signal.SIGKILL)
    assert seen | {len(load(path).topics)} <= {0, 100}
