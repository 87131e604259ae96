"""A real other side: the command without its console, and a talker, each in a process of its own."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from tests.console.driving import Steps, drive
from tests.support.forker import Forked
from tests.support.locks import domains_of
from tests.support.ports import free_port

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import load, save
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.model.snapshot import Snapshot
from rsb_console.app import ConsoleApp

HERE = domains_of("nodes")
THERE = HERE + 1
ELSEWHERE = domains_of("programs")
"""ROS domains of this run's own: otherwise the searched lists would have other tests' topics."""
COMMAND = Path(sys.executable).with_name("rsb-console")


PROGRAM = "rsb_console"


class Pair:
    """Two session files with one key: a client's, for the console under test, and a server's."""

    def __init__(
        self, folder: Path, *topics: Topic, domains: tuple[int, int] = (HERE, THERE), stale_after: float = 1.0
    ) -> None:
        write_key(folder / "robot1.key")
        common: dict[str, Any] = {
            "name": "robot1",
            "server_ip": "127.0.0.1",
            "server_port": free_port(),
            "key_file": "robot1.key",
        }
        here, there = domains
        self.client = Session(role="client", domain_id=here, stale_after=stale_after, topics=topics, **common)
        self.client_path, self.server_path = folder / "client.yaml", folder / "server.yaml"
        save(self.client, self.client_path)
        save(Session(role="server", domain_id=there, **common), self.server_path)

    def server(self, program: str = PROGRAM) -> AbstractContextManager[Forked]:
        return bridging(self.server_path, program=program)


def bridging(path: Path, *options: str, program: str = PROGRAM) -> AbstractContextManager[Forked]:
    return running(program, "run", "--no-ui", str(path), *options)


def talker(topic: str, rate: float = 20.0, domain: int = HERE) -> AbstractContextManager[Forked]:
    """Publishes `topic` on this side."""
    return running("tests.console.talker", str(domain), topic, str(rate))


def console(path: Path) -> ConsoleApp:
    """The console on a session file."""
    return ConsoleApp(load(path), path, theme="dark")


def watch(app: ConsoleApp, steps: Steps) -> None:
    """Run `steps` on the console; stop its engine."""
    try:
        drive(app, steps)
    finally:
        app.stop()


def flows(now: Snapshot, topic: str) -> bool:
    """Whether a topic carries about what its talker says."""
    return any(route.topic == topic and route.rate > 0 for route in now.routes)


@contextlib.contextmanager
def running(module: str, *arguments: str) -> Iterator[Forked]:
    """A process, ended with the block."""
    with Forked(module, *arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            end(process)


def end(process: Forked) -> None:
    """Let it go, by force only if need be: what is killed leaves its shared memory behind."""
    process.terminate()
    try:
        process.wait(20)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
