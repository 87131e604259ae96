"""JSON streams and exit codes are as documented."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from tests.console.scripted import EVENTS, ScriptedEngine, route
from tests.support.commands import documented_commands, parser_and_commands, subcommands_of

from rsb_bridge.model.calls import CallsSnapshot
from rsb_bridge.model.verdict import LinkCause
from rsb_console.command import shell
from rsb_console.command.arguments import EPILOG
from rsb_console.command.formatting import json_event, json_status, route_of

DOCS = Path(__file__).parents[2] / "docs"
HEADLESS = (DOCS / "headless.md").read_text()


def rows(heading: str) -> list[str]:
    """The first cells of the table under a heading."""
    section = re.split(r"\n#+ ", HEADLESS.partition(f"# {heading}\n")[2])[0]
    return [line.split("|")[1] for line in section.splitlines() if line.startswith("|")][2:]


def fields(heading: str) -> set[str]:
    """The fields that a table lists, each in code."""
    return {field for cell in rows(heading) for field in re.findall(r"`(\w+)`", cell)}


STATUS = json.loads(json_status(ScriptedEngine().now))["status"]


@pytest.mark.parametrize(
    ("heading", "printed"),
    [
        ("An event", json.loads(json_event(EVENTS[0]))),
        ("A link", STATUS["links"]["robot1"]),
        ("A route", STATUS["routes"][0]),
    ],
)
def test_the_fields_that_are_documented_are_printed(heading: str, printed: dict[str, object]) -> None:
    assert fields(heading) == printed.keys()


def test_fields_of_calls_that_are_documented_are_printed() -> None:
    topic, called = (
        route_of(replace(route("/dock"), calls=calls)) for calls in (None, CallsSnapshot())
    )  # fmt: skip
    shared = [*topic][: [*topic].index("latency_p99") + 1]
    assert [*called] == [*shared, *re.findall(r"^\| `(\w+)` \|", called_section(), re.MULTILINE)]


def called_section() -> str:
    return re.split(r"\n#+ ", HEADLESS.partition("### A route of calls\n")[2])[0]


def test_every_command_with_json_has_a_row() -> None:
    # What stop, save and the like print has no more than `ok`.
    only_ok = {"stop", "restart", "shutdown", "bench", "attach", "run", "fleet", "events", "save"}
    commands = subcommands_of(parser_and_commands()[0])
    with_json = {name for name, parser in commands.items() if "--json" in parser.format_help()}
    assert with_json - only_ok <= documented_commands()


def test_exit_codes_are_in_one_table_and_help() -> None:
    codes = [int(code) for cell in rows("Exit codes") for code in cell.split(",")]
    names = ("OK", "FAILURE", "USAGE", "NOT_RUNNING", "ALREADY_RUNNING", "HUNG_UP", "INTERRUPTED", "TERMINATED")
    assert codes == [getattr(shell, name) for name in names]
    assert codes == [int(code) for code in re.findall(r"^  (\d+) ", EPILOG, re.MULTILINE)]


def test_every_cause_of_a_link_is_documented() -> None:
    text = (DOCS / "states.md").read_text(encoding="utf-8")
    headings = ("## Why a link is not up\n", "## Faults of a link that is up\n")
    tables = "".join(text.partition(heading)[2].partition("\n## ")[0] for heading in headings)
    cells = re.findall(r"^\| (`[^|]+`) \|", tables, re.MULTILINE)
    assert {code for cell in cells for code in re.findall(r"`(\w+)`", cell)} == {
        cause.value for cause in LinkCause if cause
    }


def test_each_picture_is_on_a_page() -> None:
    root = DOCS.parent
    folders = [DOCS / "pictures", *root.glob("extras/rsb_extras/*/docs/pictures")]
    pages = [root / "README.md", *(page for folder in folders for page in folder.parent.glob("*.md"))]
    shown = {
        (page.parent / picture).resolve()
        for page in pages
        for picture in re.findall(r"!\[[^\]]*\]\(([^):]+)\)", page.read_text(encoding="utf-8"))
    }
    assert {picture.resolve() for folder in folders for picture in folder.iterdir()} <= shown
