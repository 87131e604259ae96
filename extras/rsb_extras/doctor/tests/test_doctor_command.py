"""`rsb-console doctor` as operators and programs run it."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from tests.console.scripted import ScriptedEngine
from tests.console.terminal import Terminal
from tests.support import surroundings
from tests.support.captured import captured
from tests.support.commands import parser_and_commands

from rsb_bridge.config.keys import write_key
from rsb_bridge.model.finding import Finding, Grade
from rsb_extras.doctor.doctor_command import lines, terminal_check
from rsb_extras.history.report_command import ReportProblem

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.support.commands import Ran
    from tests.support.control import Machine

SESSION = "name: robot1\nrole: client\nserver_ip: 127.0.0.1\nserver_port: 7060\nkey_file: robot1.key\ndomain_id: 5\n"


def run(*arguments: str, **environ: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rsb_console", "doctor", *arguments]
    return subprocess.run(command, env=os.environ | environ, capture_output=True, text=True, timeout=120, check=False)


def test_a_machine_in_json() -> None:
    ran = run("--json")
    assert (ran.returncode, ran.stderr) == (0, "")
    report = json.loads(ran.stdout)
    assert report["worst"] in {"ok", "note", "unknown", "warning"}
    grades = {each["code"]: each["grade"] for each in report["findings"]}
    assert grades["ros"] == "ok"
    assert {"program", "udp_buffers", "clock", "multicast", "firewall", "terminal", "disk"} <= set(grades)
    assert all(each["facts"] is not None and each["subject"] for each in report["findings"])


def test_what_is_wrong_comes_last_and_counts(tmp_path: Path) -> None:
    """A broken package of the name rclpy replaces a broken installation."""
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy/__init__.py").write_text("raise ImportError('librcl.so: cannot open shared object file')\n")
    ran = run(PYTHONPATH=str(tmp_path), COLUMNS="80")
    assert (ran.returncode, ran.stderr) == (1, "")
    *_, remedy, last = ran.stdout.splitlines()
    assert last.startswith("1 error")
    assert remedy.lstrip().startswith("> ")
    assert "librcl.so" in ran.stdout.partition("ERROR")[2]
    assert "Traceback" not in ran.stdout


def test_a_session(tmp_path: Path, ran: Callable[..., Ran]) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(SESSION)
    assert ran("doctor", str(path)).code == 1  # its key is missing
    write_key(tmp_path / "robot1.key")
    report = ran("doctor", str(path), "--json")
    assert report.code == 0
    assert [each["grade"] for each in report.json["findings"] if each["code"] == "keys"] == ["ok"]
    path.write_text("name: robot1\nrole: nobody\n")
    assert ran("doctor", str(path)).code == 2


def test_commands_are_not_broken_into_lines() -> None:
    command = "sudo " + "x" * 200
    found = [Finding("a", Grade.WARNING, "a", "word " * 40, command), Finding("b", Grade.OK, "b", "fine")]
    first, *rest = lines(found, 80)
    assert first.split() == ["ok", "b", "fine"]
    assert rest[-1] == "1 warning"
    assert rest[-2].endswith(command)
    assert all(len(line) < 80 for line in rest[:-2])


@pytest.mark.parametrize(
    ("environ", "size", "grades"),
    [
        ({"TERM": "xterm-256color", "LANG": "C.UTF-8"}, (100, 30), [Grade.OK]),
        ({"TERM": "linux", "LANG": "C.UTF-8"}, (100, 30), [Grade.NOTE]),
        ({"TERM": "xterm", "LANG": "C"}, (60, 20), [Grade.NOTE, Grade.WARNING]),
        ({"TERM": "dumb"}, (100, 30), [Grade.WARNING]),
    ],
)
def test_terminals(
    environ: dict[str, str], size: tuple[int, int], grades: list[Grade], monkeypatch: pytest.MonkeyPatch
) -> None:
    surroundings.print_to_terminal(monkeypatch)
    for name, cells in zip(("COLUMNS", "LINES"), size, strict=True):
        monkeypatch.setenv(name, str(cells))
    assert [each.grade for each in terminal_check(environ).run()] == grades


def test_a_report_ends_with_this_machine(ran: Callable[..., Ran], machine: Machine) -> None:
    machine.serve(ScriptedEngine())
    lines = ran("report").out.splitlines()
    heading = ReportProblem.OPERATOR_MACHINE(host=platform.node(), source="rsb-console doctor")
    assert any(line.startswith("ok       program") for line in lines[lines.index(heading) + 1 :])
    found = ran("report", "--json").json["operator_machine"]
    assert [*found] == ["host", "worst", "findings"]
    assert "program" in {each["code"] for each in found["findings"]}


def test_it_runs_nothing_of_its_folder(planted: Path) -> None:
    program = "import sys; sys.argv = ['rsb-console', 'doctor', '--json']; from rsb_console.cli import main; main()"
    ran = captured(sys.executable, "-P", "-c", program)
    assert '"ros"' in ran.stdout
    assert not planted.exists()


def test_it_draws_ascii_where_terminal_has_no_more() -> None:
    environ = {"LANG": "C", "LC_ALL": "", "LC_CTYPE": "", "TERM": "vt100"}
    with Terminal("rsb_console", "doctor", environ=environ, forked=True) as terminal:
        terminal.exit_code()
        assert terminal.output
        assert terminal.output.isascii()


def test_it_is_listed_where_operators_look_for_it() -> None:
    names = parser_and_commands()[1]
    assert names[names.index("check") + 1] == "doctor"
