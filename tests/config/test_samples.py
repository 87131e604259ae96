"""The sample sessions and the systemd unit that ship with the project."""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from tests.config.samples import CONFIGS, SAMPLES
from tests.support.captured import captured
from tests.support.systemd import exposure

from rsb_bridge.config.session_file import load, parse
from rsb_console.command.arguments import parser_and_commands

ROOT = CONFIGS.parent
FEATURES = "extras/rsb_extras/"
ABSENT = (FEATURES, "bench/")
"""Folders that the core alone does not have."""
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    *sorted(ROOT.glob("docs/*.md")),
    *sorted(ROOT.glob(f"{FEATURES}*/docs/*.md")),
]
UNIT = CONFIGS / "rsb-console@.service"


def test_two_sides_of_readmes_first_bridge_fit() -> None:
    readme = (CONFIGS.parent / "README.md").read_text(encoding="utf-8")
    server, client = (parse(block.partition("```")[0], Path("README.md")) for block in readme.split("```yaml\n")[1:])
    assert (server.role, client.role) == ("server", "client")
    assert server.server_port == client.server_port
    assert [(each.name, each.key_file) for each in server.listed_clients] == [(client.name, client.key_file)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_between_the_pages_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)#:]+)[^)]*\)", page.read_text(encoding="utf-8")):
        may_lack = any(each in link for each in ABSENT) and not (ROOT / "extras").exists()
        assert (page.parent / link).exists() or may_lack, link


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_sample_holds_no_key_and_stands_alone(path: Path, tmp_path: Path) -> None:
    assert parse(path.read_text(encoding="utf-8"), tmp_path / path.name) == load(path)


def test_the_unit_runs_a_command_that_exists() -> None:
    (line,) = [line for line in UNIT.read_text().splitlines() if line.startswith("ExecStart=")]
    shell = shlex.split(line.removeprefix("ExecStart="))[-1]
    command = shlex.split(shell.partition("exec rsb-console ")[2])
    arguments = parser_and_commands()[0].parse_args(command)
    assert arguments.no_ui
    assert arguments.session == Path("/etc/rsb-console/%i.yaml")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_takes_the_unit(tmp_path: Path) -> None:
    unit = tmp_path / "rsb-console@robot1.service"
    shutil.copy(UNIT, unit)
    run = captured("systemd-analyze", "verify", "--recursive-errors=no", str(unit))
    assert [line for line in run.stderr.splitlines() if unit.name in line] == []


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_the_unit_leaves_little_to_an_intruder() -> None:
    assert exposure(UNIT) < 3
