"""The units that `service install` writes: their content, systemd's assessment, and files that stay unchanged."""

from __future__ import annotations

import getpass
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.support.captured import captured
from tests.support.commands import parser_and_commands
from tests.support.systemd import exposure
from tests.support.wording import says

from rsb_bridge.config.session_file import save
from rsb_bridge.model.session import Session
from rsb_extras.service.systemd_service import CONFINED, Service, ServiceText, kept_variables, program, unit_name
from rsb_extras.service.tests.service_places import PROGRAM_ARGUMENTS, SYSTEM_UNITS

UNIT = Path(__file__).parents[4] / "configs/rsb-console@.service"


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    SYSTEM_UNITS.set(monkeypatch, tmp_path / "system")
    for name in (*kept_variables(os.environ), "ROS_DISTRO"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


@pytest.fixture
def session(tmp_path: Path) -> Path:
    path = tmp_path / "robot1.yaml"
    save(Session(name="robot1", role="client", server_ip="127.0.0.1", server_port=5000, key_file="robot1.key"), path)
    return path


@pytest.fixture
def ran(capsys: pytest.CaptureFixture[str]) -> Any:
    def run(*arguments: object) -> tuple[int, str, str]:
        parsed = parser_and_commands()[0].parse_args(["service", *map(str, arguments)])
        code = parsed.command(parsed)
        return code, *capsys.readouterr()

    return run


def test_users_service_is_written_with_next_steps(ran: Any, session: Path, home: Path) -> None:
    unit = home / "config/systemd/user/rsb-console-robot1.service"
    code, out, _ = ran("install", session)
    assert code == 0
    assert out.splitlines()[0] == f"{unit}: written. Run next:"
    for command in (
        "systemctl --user daemon-reload",
        "systemctl --user enable --now rsb-console-robot1.service",
        "loginctl enable-linger",
    ):
        assert f"  {command}" in out
    assert unit.stat().st_mode & 0o777 == 0o644
    text = unit.read_text()
    for line in ("Type=notify", "WatchdogSec=30", "ExecReload=/bin/kill -HUP $MAINPID", "WantedBy=default.target"):
        assert line in text.splitlines()
    assert f'"run" "--no-ui" "--log-format" "json" "{session}"' in text
    assert ran("show", session)[1] == text
    assert ran("install", session)[1].startswith(f"{unit}: unchanged.")


def test_unit_that_differs_is_replaced_by_force_only(ran: Any, session: Path, home: Path) -> None:
    unit = home / "config/systemd/user/rsb-console-robot1.service"
    unit.parent.mkdir(parents=True)
    unit.write_text("[Service]\nExecStart=/bin/true\n")
    code, _, err = ran("install", session)
    assert code == 1
    assert says(err, ServiceText.OTHER_UNIT, path=unit)
    assert "/bin/true" in unit.read_text()
    assert ran("uninstall", session)[0] == 1
    assert ran("install", "--force", session)[0] == 0
    assert "/bin/true" not in unit.read_text()


def test_a_service_is_uninstalled_once_it_is_disabled(ran: Any, session: Path, home: Path) -> None:
    unit = home / "config/systemd/user/rsb-console-robot1.service"
    assert says(ran("uninstall", session)[2], ServiceText.NO_UNIT, path=unit)
    ran("install", session)
    enabled = unit.parent / "default.target.wants" / unit.name
    enabled.parent.mkdir()
    enabled.symlink_to(unit)
    code, _, err = ran("uninstall", session)
    assert code == 1
    assert says(err, ServiceText.ENABLED, name=unit.name, control="systemctl --user")
    enabled.unlink()
    code, out, _ = ran("uninstall", session)
    assert code == 0
    assert "systemctl --user daemon-reload" in out
    assert not unit.exists()


def test_service_of_system_runs_as_files_owner(ran: Any, session: Path, home: Path) -> None:
    code, out, _ = ran("install", "--system", session)
    assert code == 0
    assert "sudo systemctl enable --now rsb-console-robot1.service" in out
    assert "linger" not in out
    lines = (home / "system/rsb-console-robot1.service").read_text().splitlines()
    for line in (
        f"User={getpass.getuser()}",
        "StateDirectory=rsb-console",
        "LogsDirectory=rsb-console",
        "Environment=ROS_LOG_DIR=%L/rsb-console",
        "WantedBy=multi-user.target",
    ):
        assert line in lines


@pytest.mark.parametrize(("folder", "protected"), [("/home/anna/bridge", "read-only"), ("/etc/rsb-console", "true")])
def test_service_of_system_sees_its_session_file(folder: str, protected: str) -> None:
    made = Service(Path(folder) / "robot1.yaml", ("/usr/bin/rsb-console",), system=True, user="ros")
    assert f"ProtectHome={protected}" in made.text().splitlines()


def test_a_bad_session_is_not_installed(ran: Any, session: Path, home: Path) -> None:
    session.write_text("name: robot1\nrole: nobody\n")
    code, _, err = ran("install", session)
    assert code == 2
    assert "robot1.yaml:2" in err
    assert not (home / "config").exists()


def test_what_ros_takes_from_the_environment_goes_along(
    ran: Any, session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.setenv("CYCLONEDDS_URI", '<a b="50%">')
    out = ran("show", session)[1]
    assert 'Environment="ROS_DOMAIN_ID=7"' in out
    assert 'Environment="CYCLONEDDS_URI=<a b=\\"50%%\\">"' in out


def test_service_finds_the_nodes_that_the_shell_finds(ran: Any, session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = {
        "CYCLONEDDS_URI": "file:///a.xml",
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        "RMW_FASTRTPS_PUBLICATION_MODE": "SYNCHRONOUS",
        "ROS2_EASY_MODE": "10.0.0.1",
        "ROS_DISCOVERY_SERVER": "10.0.0.1:11811;",
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_ENCLAVE_OVERRIDE": "/robot1",
        "ROS_SECURITY_KEYSTORE": "/keys",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SUPER_CLIENT": "True",
        "ZENOH_ROUTER_CONFIG_URI": "/a.json5",
        "ZENOH_SESSION_CONFIG_URI": "/b.json5",
    }
    others = {"ROS_DISTRO": "jazzy", "ROS_PYTHON_VERSION": "3", "ROS_LOG_DIR": "/home/a", "ZENOH_TOKEN": "a secret"}
    for name, value in {**kept, **others}.items():
        monkeypatch.setenv(name, value)
    lines = ran("show", session)[1].splitlines()
    assert [line for line in lines if line.startswith("Environment=")] == [
        f'Environment="{name}={value}"' for name, value in kept.items()
    ]


def test_a_setup_file_is_sourced_first(ran: Any, session: Path, tmp_path: Path) -> None:
    """It runs in the shell, with the arguments that systemd would pass on."""
    setup = tmp_path / "my setup.bash"
    setup.write_text("export FROM_SETUP=yes\n")
    out = ran("show", "--setup", setup, session)[1]
    (line,) = [line for line in out.splitlines() if line.startswith("ExecStart=")]
    assert line.startswith(f'ExecStart="/bin/bash" "-c" "source \\"$$0\\" && exec \\"$$@\\"" "{setup}" ')
    made = Service(session, ("/usr/bin/env",), system=False, user="", setup=setup)
    words = made.command()[:4]
    done = subprocess.run([*words, "/usr/bin/env"], capture_output=True, text=True, check=True)
    assert "FROM_SETUP=yes" in done.stdout.splitlines()


@pytest.mark.parametrize("stem", ["robot1", "a robot $HOME 50%", "ünï"])
def test_name_of_unit_is_one_that_systemd_takes(stem: str) -> None:
    assert set(unit_name(Path(f"/x/{stem}.yaml"))) <= set(
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789:_.-"
    )


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
@pytest.mark.parametrize("system", [False, True], ids=["user", "system"])
@pytest.mark.parametrize("name", ["robot1", "a robot $HOME 50%"])
def test_systemd_takes_the_units(tmp_path: Path, system: bool, name: str) -> None:
    setup = tmp_path / "setup.bash"
    made = Service(
        tmp_path / f"{name}.yaml",
        ("/bin/true",),
        system=system,
        user=getpass.getuser(),
        setup=setup,
        environment={"ROS_DOMAIN_ID": "7"},
    )
    unit = tmp_path / made.name
    unit.write_text(made.text())
    run = captured(
        "systemd-analyze",
        "verify",
        "--recursive-errors=no",
        *(() if system else ("--user",)),
        str(unit),
        env={"XDG_RUNTIME_DIR": str(tmp_path), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)},
    )
    assert [line for line in run.stderr.splitlines() if unit.name in line] == []
    if system:
        assert exposure(unit) < 3


def test_what_the_command_installs_is_confined_as_much() -> None:
    lines = UNIT.read_text().splitlines()
    made = Service(Path("/etc/rsb-console/robot1.yaml"), ("/bin/true",), system=True, user="ros").text().splitlines()
    assert set(CONFINED) <= set(lines)
    names = {line.partition("=")[0] for line in CONFINED} | {"LimitNOFILE", "NoNewPrivileges", "ProtectHome", "UMask"}
    for each in (lines, made):
        assert {line.partition("=")[0] for line in each} >= names


def test_a_service_runs_nothing_of_its_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    """systemd's working folder of a user's service is the user's home."""
    PROGRAM_ARGUMENTS.set(monkeypatch, ["/nowhere/pytest"])
    assert program() == (sys.executable, "-P", "-m", "rsb_console")
