"""Fixtures of the tests of commands: the program's arguments in, its exit code and its output back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.support import constants
from tests.support.commands import Ran
from tests.support.locks import alone
from tests.support.ports import free_port

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.model.session import Session, Topic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.support.control import Machine


@pytest.fixture
def here(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have commands look for bridges in this test's folder of control sockets."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", machine.environ["XDG_RUNTIME_DIR"])
    constants.BRIDGES_ASKED_FOR.set(monkeypatch, 60.0)  # the bridges are threads of this process, and may stand still


@pytest.fixture
def ran(here: None, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """Run a command at the bridges of `machine`."""
    return lambda *arguments: Ran(capsys, *arguments)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A client's session file, whose server does not run."""
    pytest.importorskip("rclpy", reason="needs ROS 2")
    write_key(tmp_path / "robot1.key")
    made = tmp_path / "robot1.yaml"
    common: dict[str, Any] = {"server_ip": "127.0.0.1", "server_port": free_port(), "domain_id": 85}
    topics = (Topic("/scan", "transmit"),)
    save(Session(name="robot1", role="client", key_file="robot1.key", topics=topics, **common), made)
    return made


@pytest.fixture
def only_demo() -> Iterator[None]:
    """Two demos could choose the same domains."""
    with alone("demo"):
        yield
