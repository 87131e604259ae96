"""The command `import`, as a process, with a file of the thesis."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.support.commands import rsb_console
from tests.support.foreign_files import BRINGUP
from tests.support.wording import says

from rsb_bridge.config.session_file import load
from rsb_extras.imports.import_command import ImportText
from rsb_extras.imports.other_bridges import OtherFile


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_import_writes_a_session_that_loads() -> None:
    Path("bringup.yaml").write_text(BRINGUP)
    Path("sessions").mkdir()
    rsb_console("keygen")
    arguments = ("import", "bringup.yaml", "--name", "robot1", "--key-file", "key.txt", "-o", "sessions/new.yaml")
    run = rsb_console(*arguments)
    assert (run.returncode, run.stderr) == (0, "")
    assert says(run.stdout, ImportText.IMPORTED, path="sessions/new.yaml")
    session = load(Path("sessions/new.yaml"))
    assert session.key_file == "../key.txt"
    assert [topic.topic for topic in session.topics] == ["/topic"]
    assert "warning" not in rsb_console("check", "sessions/new.yaml").stdout
    assert rsb_console(*arguments).returncode == 1
    assert rsb_console(*arguments, "--force", "--role", "server").returncode == 0
    assert load(Path("sessions/new.yaml")).role == "server"


def test_import_to_standard_output_and_its_mistakes() -> None:
    Path("bringup.yaml").write_text(BRINGUP)
    run = rsb_console("import", "bringup.yaml", "--name", "robot1", "--no-encryption", "--port", "4000")
    assert run.returncode == 0
    assert "server_port: 4000" in run.stdout
    refused = rsb_console("import", "bringup.yaml", "--name", "robot1")
    assert refused.returncode == 2
    assert "key_file: missing" in refused.stderr
    assert says(refused.stderr, ImportText.KEY_OPTION, field="key_file", option="--key-file PATH, or --no-encryption")
    assert "--port" not in refused.stderr
    assert rsb_console("import", "bringup.yaml").returncode == 2
    Path("bringup.yaml").write_text("server_node:\n  ros__parameters:\n    server_ip: '127.0.0.1'\n")
    refused = rsb_console("import", "bringup.yaml", "--name", "robot1", "--no-encryption")
    assert says(refused.stderr, ImportText.KEY_OPTION, field="server_port", option="--port N")


@pytest.mark.parametrize("command", [("check",), ("run", "--no-ui")])
def test_thesis_file_as_session_leads_to_import(command: tuple[str, ...]) -> None:
    Path("bringup.yaml").write_text(BRINGUP)
    run = rsb_console(*command, "bringup.yaml")
    assert run.returncode == 2
    assert run.stderr == (
        f"rsb-console: bringup.yaml: {OtherFile.CONVERT(origin='ros2_socket_bridge', path='bringup.yaml')}\n"
    )
