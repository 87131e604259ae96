"""No child of the program runs a module that lies in its working folder, as `python -m` and `python -c` would."""

from __future__ import annotations

import ast
import re
import subprocess
from pathlib import Path

from tests.command.children_helpers import planted

from rsb_console.child import ChildProcess

__all__ = ["planted"]

ROOT = Path(__file__).parents[2]
SOURCES = [
    path
    for folder in (".ci", "bridge", "console", "extras", "deb", "docs", "ros")
    for path in (ROOT / folder).rglob("*.py")
    if "tests" not in path.relative_to(ROOT).parts
]
BEGINS_AGAIN = "console/rsb_console/cli.py"  # executes itself, which starts no child
STARTS = {"Popen", "run", "call", "check_call", "check_output", "create_subprocess_exec", "create_subprocess_shell"}
IN_PYTHON = ("fork", "forkpty", "system", "popen", "startfile", "exec", "spawn", "posix_spawn")
MAY_START = {
    ".ci/core.py", ".ci/install.py", ".ci/net.py", ".ci/pythons.py",
    "extras/rsb_extras/doctor/machine.py", "extras/rsb_extras/doctor/ros_setup.py",
    "extras/rsb_extras/doctor/large_messages.py", "extras/rsb_extras/doctor/session_needs.py",
    "extras/rsb_extras/exporters/fault_hook.py", "extras/rsb_extras/mcp_server/mcp_command.py",
    "extras/rsb_extras/bench/loopback.py", "extras/rsb_extras/pictures/confinement_check.py",
    "extras/rsb_extras/pictures/renderer.py",
    # They run what the operator wrote, in the folder where the operator started the console; and tmux by its path.
    "extras/rsb_extras/own_commands/interactive.py", "extras/rsb_extras/own_commands/running.py",
    # It runs what the session's file lists, in the root folder.
    "extras/rsb_extras/units/unit_process.py",
    "console/rsb_console/terminal/tmux.py", "console/rsb_console/child.py", "deb/build.py", "docs/real_terminals.py",
}  # fmt: skip
"""Modules that start children. A new one belongs here once its child does not look into its working folder."""


def nodes(path: Path, *words: str) -> list[ast.AST]:
    """Parse a module that has one of some words: to parse all of them takes seconds."""
    text = path.read_text(encoding="utf-8")
    return list(ast.walk(ast.parse(text))) if any(word in text for word in words) else []


def is_interpreter(node: ast.AST) -> bool:
    return isinstance(node, ast.Attribute) and node.attr == "executable" and isinstance(node.value, ast.Name)


def test_each_command_line_of_python_has_p() -> None:
    """`-P` comes first, or the interpreter is only named in a text."""
    checked = []
    for path in SOURCES:
        for node in nodes(path, "executable"):
            if isinstance(node, ast.List | ast.Tuple) and any(map(is_interpreter, node.elts)):
                checked.append(path.name)
                index = next(index for index, each in enumerate(node.elts) if is_interpreter(each))
                following = node.elts[index + 1]
                assert isinstance(following, ast.Constant), f"{path}:{node.lineno}"
                assert following.value == "-P", f"{path}:{node.lineno}: a module of the working folder would run"
    assert len(checked) >= 5


def test_no_shell_runs_python_without_p() -> None:
    for path in SOURCES:
        assert not re.search(r"bin/python\S* -[mc]", path.read_text(encoding="utf-8")), path


def test_every_module_that_starts_children_is_known() -> None:
    found = set()
    for path in SOURCES:
        for node in nodes(
            path, *(f"os.{name}" for name in IN_PYTHON), "subprocess", "multiprocessing", "import pty", "Popen"
        ):
            name = str(path.relative_to(ROOT))
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = [each.name for each in node.names] + [getattr(node, "module", None) or ""]
                assert not {"multiprocessing", "pty"} & {each.split(".")[0] for each in names}, name
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                called, of = node.func.attr, getattr(node.func.value, "id", "")
                assert not (of == "os" and called.startswith(IN_PYTHON)) or name == BEGINS_AGAIN
                if of in {"subprocess", "asyncio"} and called in STARTS and (of, called) != ("asyncio", "run"):
                    found.add(name)
            if isinstance(node, ast.ClassDef) and any(
                getattr(b, "attr", "") == "Popen"
                or (isinstance(b, ast.Subscript) and getattr(b.value, "attr", "") == "Popen")
                for b in node.bases
            ):
                found.add(name)
    assert found == {each for each in MAY_START if (ROOT / each).exists()}, "the core alone has fewer"


def test_module_in_child_runs_nothing_of_its_folder(planted: Path) -> None:
    with ChildProcess("rsb_console", "--version", stdout=subprocess.PIPE) as child:
        assert child.communicate(timeout=180)[0].startswith("rsb-console ")
    assert not planted.exists()
