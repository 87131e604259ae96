"""The program does all that it should where it may do no more than the systemd unit lets it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.support.domain import text
from tests.support.program import Program
from tests.support.waiting import eventually
from tests.system.confined_helpers import CONFINED, ROOT, confined, has_seccomp

from rsb_bridge.config.session_file import save
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.model.session import Session


pytestmark = pytest.mark.skipif(not has_seccomp(), reason="systemd-analyze and libseccomp are not installed")


class Service:
    """One bridge, as the unit runs it; its folders are in one of its own."""

    def __init__(self, session: Session, folder: Path) -> None:
        self.path, self.state = folder / f"{session.role}.yaml", folder / f"state-{session.role}"
        self.state.mkdir(mode=0o700)
        save(session, self.path)
        log = folder / f"{session.role}.log"
        run = ["run", "--no-ui", "--log-format", "json", "--control", f"{self.path}.sock", str(self.path)]
        with log.open("wb") as output:
            self.process = subprocess.Popen(
                [*CONFINED, sys.executable, "-m", "rsb_console", *run],
                cwd=ROOT, stdout=output, stderr=output, env={**os.environ, "STATE_DIRECTORY": str(self.state)},
            )  # fmt: skip
        self.program = Program(self.process.pid, log)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


@pytest.fixture
def services(bridge: Bridge) -> Iterator[tuple[Service, Service]]:
    topics = (
        Topic("/over_tcp", "transmit", type="String"),
        Topic("/over_udp", "transmit", type="String", protocol="udp"),
    )
    made = [Service(session, bridge.folder) for session in (bridge.server_session(), bridge.client_session(*topics))]
    yield made[0], made[1]
    for each in made:
        each.kill()


def test_both_sides_of_a_bridge(services: tuple[Service, Service], robot: Domain, pc: Domain) -> None:
    server, client = services
    listeners = [pc.listener(topic) for topic in ("/over_tcp", "/over_udp")]
    publishers = [robot.publisher(topic) for topic in ("/over_tcp", "/over_udp")]
    sent = 0

    def crossed() -> bool:
        nonlocal sent
        sent += 1
        for publisher in publishers:
            publisher.publish(text(f"message {sent}"))
        return all(listener.payloads for listener in listeners)

    eventually(crossed, what="messages on both topics")
    control = [sys.executable, "-m", "rsb_console", "status", "--control", f"{client.path}.sock"]
    eventually(lambda: subprocess.run(control, cwd=ROOT, capture_output=True, timeout=180, check=False).returncode == 0)
    client.program.signal(signal.SIGHUP)
    eventually(lambda: EventCode.OPERATOR_RELOADED.value in client.program.output, what=client.program.output)
    for each in (server, client):
        each.program.signal(signal.SIGTERM)
        assert each.process.wait(60) == 0, each.program.output
        assert "Traceback" not in each.program.output
        kept = list(each.state.iterdir())
        assert kept
        assert all(path.stat().st_mode & 0o077 == 0 for path in kept)


def test_bluetooth_sockets_are_left() -> None:
    """Whether this kernel has Bluetooth or not, the filter is not what says no; of other families it does."""
    script = "import socket, sys; socket.socket(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))"
    for arguments in ((31, 1, 3), (31, 3, 1)):
        run = confined(sys.executable, "-c", script, *map(str, arguments))
        assert "PermissionError" not in run.stderr
    assert "PermissionError" in confined(sys.executable, "-c", script, "17", "3", "0").stderr, "AF_PACKET"


def test_what_a_bridge_does_not_need_is_refused() -> None:
    run = confined(sys.executable, "-c", "import os; os.sched_setaffinity(0, {0})")
    assert "PermissionError" in run.stderr
    assert confined("/bin/sh", "-c", "umask; ulimit -n").stdout.split()[0] == "0077"
