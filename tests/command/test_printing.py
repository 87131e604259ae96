"""Texts from engines, peers, files and arguments do nothing to a terminal, in any command."""

from __future__ import annotations

import ast
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.command.printing_helpers import EVIL
from tests.console.scripted import SESSION, ScriptedEngine, route
from tests.support import replaced
from tests.support.commands import Ran, rsb_console
from tests.support.running import Running

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import RefusedClient, State
from rsb_bridge.model.text import escape_json, is_clean, one_line, several_lines
from rsb_console.command.headless import LogWriter
from rsb_console.command.shell import CleanErrors, print_error, print_line, print_lines, redraw_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.support.control import Machine

CONSOLE = Path(__file__).parents[2] / "console" / "rsb_console"
EXTRAS = Path(__file__).parents[2] / "extras" / "rsb_extras"
PRINTS = {
    "command/shell.py": "print_line, print_lines, redraw_line, print_error and CleanErrors",
    "command/headless.py": "lines of the log, each cleaned by `LogWriter.write`",
    "terminal/driver.py": "the app's own terminal",
    "bench/bench_command.py": "one line of progress, cleaned",
    "bench/measured_stream.py": "a child's pipe",
    "demo/router.py": "a child's pipe",
    "demo/simulated_part.py": "a child's pipe",
    "doctor/large_messages.py": "a child's pipe",
    "fleet/robots.py": "a child's pipe",
    "pictures/confinement.py": "a trial's pipe",
    "pictures/look_command.py": "rows of pictures, cleaned by `decode_picture` and `clean`",
    "pictures/worker.py": "a child's pipe",
}


def clean_lines(text: str) -> bool:
    return is_clean(text.replace("\r\n", "").replace("\n", "").replace("\t", ""))


def writes(tree: ast.AST) -> Iterator[str]:
    """The calls in a module by which a text gets to a terminal."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        is_print = name == "print" or name.startswith("traceback.print_") or name.endswith(".print_usage")
        is_stream = name.startswith(("sys.stdout.", "sys.stderr.", "sys.__std")) and "write" in name
        if is_print or is_stream or (name == "os.write" and ast.unparse(node.args[0]) in ("1", "2")):
            yield name


def test_consoles_and_features_print_by_cleaning_functions() -> None:
    found = {
        path.relative_to(part).as_posix(): calls
        for part in (CONSOLE, EXTRAS)
        for path in part.rglob("*.py")
        if "tests" not in path.relative_to(part).parts
        and re.search("print|write", text := path.read_text())
        and (calls := list(writes(ast.parse(text))))
    }
    allowed_in_cli = ["traceback.print_exception"]  # to standard error, which is a `CleanErrors`
    assert found.pop("cli.py") == allowed_in_cli
    assert set(found) <= set(PRINTS), found


@pytest.mark.parametrize("text", [EVIL, *(chr(code) for code in (0, 7, 8, 13, 27, 0x7F, 0x85, 0x9B, 0x2028, 0xD800))])
def test_what_the_functions_print_is_clean(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    print_line(text)
    assert capsys.readouterr().out.count("\n") == 1
    print_line(text)
    print_lines(text)
    print_error(text)
    out, err = capsys.readouterr()
    assert clean_lines(out)
    assert clean_lines(err)
    assert json.loads(escape_json(json.dumps({text: text}, ensure_ascii=False))) == {text: text}
    assert clean_lines(escape_json(json.dumps(text, ensure_ascii=False)))
    redraw_line(text)
    clears = "\r\x1b[K"
    out, _ = capsys.readouterr()
    assert out.startswith(clears)
    assert clean_lines(out.removeprefix(clears))
    assert "\n" not in out


def test_what_is_clean_is_left_as_it_is() -> None:
    text = 'größe → /scan "x" \\x1b ░ 東京'
    assert one_line(text) == several_lines(text) == escape_json(text) == text
    assert several_lines("a\tb\nc\r\n") == "a\tb\nc\r\n"


def test_everything_on_standard_error_is_clean() -> None:
    stream = io.StringIO()
    CleanErrors(stream).writelines([f"a {EVIL}"])
    assert clean_lines(stream.getvalue())
    assert not CleanErrors(stream).isatty()


def test_a_log_line_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with path.open("wb") as file:
        writer = LogWriter(file.fileno(), lambda *_: "")
        writer.write(f"a {EVIL}")
        writer.close(5.0)
    text = path.read_text()
    assert text.count("\n") == 1
    assert clean_lines(text)


def evil_engine() -> ScriptedEngine:
    """An engine of this machine that says such texts of its routes, links, clients and events."""
    spec = Topic("/scan", "transmit", type=f"a/msg/{EVIL}")
    fault = replace(
        route("/scan", outgoing=True, spec=spec), state=State.DOWN, cause="no_publisher", reason=EVIL, link="robot1"
    )
    named = replace(route(f"/{EVIL}", outgoing=False), type_name=EVIL, reason=EVIL)
    engine = Running(msgspec.structs.replace(SESSION, topics=(spec,)), routes=(fault, named))  # it is measured at once
    (link, *_) = engine.now.links
    refused = RefusedClient(EVIL, EVIL, "unknown_name", EVIL, 1_700_000_000.0, 3)
    engine.now = replace(
        engine.now, links=(replace(link, state=State.DOWN, reason=EVIL, peer=EVIL),), refused=(refused,)
    )
    return engine


@pytest.mark.parametrize("options", [(), ("--json",)])
@pytest.mark.parametrize(
    "command",
    ["status", "topics", "topics --available", "events", "info /scan", "info /nothing", "report", "edit /scan qos=x"],
)
def test_every_command_cleans_what_an_engine_says(
    command: str, options: tuple[str, ...], machine: Machine, ran: Callable[..., Ran]
) -> None:
    machine.serve(evil_engine())
    done = ran(*command.split(), *options)
    assert clean_lines(done.out)
    assert clean_lines(done.err)
    assert "\nforged" not in done.out.replace("2026-01-01 ", "")
    if options:
        for line in done.out.splitlines():
            json.loads(line)


@pytest.mark.parametrize(
    "arguments",
    [
        (EVIL,),
        ("status", f"--{EVIL}"),
        ("check", f"{EVIL}.yaml"),
        ("keygen", f"/nowhere/{EVIL}"),
        ("status", EVIL),
        ("run", "--status-every", EVIL, "x.yaml"),
        ("import", f"{EVIL}.yaml", "--name", "x"),
        ("client", "list", "--session", f"{EVIL}.yaml"),
        ("fleet", "status", "--fleet", f"{EVIL}.yaml"),
    ],
)
def test_arguments_do_nothing_to_the_terminal(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = rsb_console(*arguments)
    assert run.returncode
    assert run.stderr
    assert clean_lines(run.stdout + run.stderr)


def test_a_traceback_is_clean_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_: object) -> int:
        raise ValueError(EVIL)

    replaced.CHECK_SESSION.set(monkeypatch, fails)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    runs = [rsb_console("check", "x.yaml", *more, may_crash=True) for more in (("--debug",), ())]
    assert [run.returncode for run in runs] == [1, 1]
    assert "ValueError" in runs[0].stderr
    assert all(clean_lines(run.stderr) for run in runs)
    (crash,) = tmp_path.rglob("crash.log")
    assert clean_lines(crash.read_text())


ESCAPE = r"\e]0;evil\a\e[2J\u202e\x9b31m\nforged: line\r"
"""As a double-quoted scalar of YAML has it."""
FINE = "name: a\nrole: client\nserver_ip: 10.0.0.1\nserver_port: 7060\nkey_file: k\n"


@pytest.mark.parametrize(
    "content",
    [
        f'{FINE}"{ESCAPE}": 1\n',
        f'{FINE}"{ESCAPE}": 1\n"{ESCAPE}": 2\n',
        f'"{ESCAPE}": 1\n',
        f'{FINE}domain_id: "{ESCAPE}"\n',
        f'{FINE}topics:\n- {{"{ESCAPE}": 1}}\n',
        f'{FINE}topics:\n- {{topic: "{ESCAPE}", direction: transmit}}\n',
        f'{FINE}topics:\n- {{topic: /a, direction: "{ESCAPE}"}}\n',
        f'{FINE}topics:\n- {{topic: /a, direction: transmit, qos: {{"{ESCAPE}": 1}}}}\n',
        f'{FINE}profile: "{ESCAPE}"\n',
        f"{FINE}theme: !<tag:%1B%5D0;evil%07> x\n",
        f"{FINE}x: !%1B%5D0;evil%07 y\n",
        f"{FINE}x: &a 1\ny: *b\n",
        f"{FINE}x: *\u202e\n",
        f'{FINE}"\\q": 1\n',
        f"{FINE}x: [\u202e\n",
        f"{FINE}x: \x1b[31m\n",
        f"{FINE}x: \u2028\u202e: z: \u200b\n",
        FINE.replace("name: a", f'name: "{ESCAPE}"'),
        FINE.replace("role: client", "role: server")
        + f'clients:\n- {{name: "{ESCAPE}", key_file: k, "{ESCAPE}": 1}}\n',
        FINE.replace("10.0.0.1", f'"{ESCAPE}"'),
        FINE.replace("key_file: k", f'key_file: "{ESCAPE}"'),
        FINE + f'allow: ["{ESCAPE}"]\n',
    ],
)
@pytest.mark.parametrize("command", [("check",), ("run", "--no-ui")])
def test_file_contents_cannot_control_terminal(
    content: str, command: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a\x1b[31m\n.yaml"
    path.write_text(content, encoding="utf-8")
    done = Ran(capsys, *command, str(path))
    assert done.code == 2
    assert is_clean((done.out + done.err).replace("\n", ""))
    assert not [line for line in done.err.splitlines() if line.startswith("forged")]
