"""A bridge's name, as an option or as a plain word, in each command that attaches."""

from __future__ import annotations

from typing import Any

import pytest
from tests.support.commands import options_of, parser_and_commands, subcommands_of


def parsed(*words: str) -> dict[str, Any]:
    return vars(parser_and_commands()[0].parse_args(words))


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("status pc", {"bridge": "pc"}),
        ("topics pc --available", {"bridge": "pc"}),
        ("pause pc /scan", {"bridge": "pc", "topic": "/scan"}),
        ("pause pc *scan --link robot1", {"bridge": "pc", "topic": "*scan"}),
        ("pause pc --link robot1 /scan", {"bridge": "pc", "topic": "/scan", "link": "robot1"}),
        ("add pc /scan transmit max_rate=5", {"bridge": "pc", "topic": "/scan", "direction": "transmit"}),
        ("add pc --service /dock --provider client", {"bridge": "pc", "topic": "/dock", "kind": "service"}),
        ("edit pc /scan max_rate=5", {"bridge": "pc", "topic": "/scan", "keys": ["max_rate=5"]}),
        ("ack pc /scan", {"bridge": "pc", "topic": "/scan"}),
        ("ack pc robot1", {"bridge": "pc", "topic": "robot1"}),
        ("ack pc robot1 --undo", {"bridge": "pc", "topic": "robot1", "undo": True}),
        ("ack --undo robot1", {"bridge": None, "topic": "robot1"}),
        ("ack --fleet fleet.yaml robot1", {"bridge": None, "topic": "robot1"}),
        ("pause pc scan --link robot1", {"bridge": "pc", "topic": "scan", "link": "robot1"}),
        ("fleet pc", {"bridge": "pc"}),
        ("fleet pc --json --seconds 1", {"bridge": "pc", "json": True}),
        ("fleet --bridge pc", {"bridge": "pc"}),
        ("fleet pc exec robot1 -- pause /scan", {"bridge": "pc", "names": ["robot1"]}),
        ("fleet pc dismiss robot1", {"bridge": "pc", "names": ["robot1"]}),
        ("fleet exec pc robot1 -- pause /scan", {"bridge": None, "names": ["pc", "robot1"]}),
        ("look pc /map /scan --once", {"bridge": "pc", "topics": ["/map", "/scan"]}),
        ("pub pc /goal {}", {"bridge": "pc", "topic": "/goal", "message": "{}"}),
        ("call pc /dock", {"bridge": "pc", "topic": "/dock", "request": ""}),
        ("param get pc /node speed", {"bridge": "pc", "topic": "/node", "parameter": "speed"}),
        ("wait pc --for flowing /scan", {"bridge": "pc", "wanted": ["flowing", "/scan"]}),
        ("wait --for linked --bridge pc", {"bridge": "pc", "wanted": ["linked"]}),
        ("bench pc", {"bridge": "pc"}),
        ("bench --bridge pc", {"bridge": "pc"}),
        # no bridge
        ("pause /scan", {"bridge": None, "topic": "/scan"}),
        ("pause scan", {"bridge": None, "topic": "scan"}),
        ("ack robot1 --control /run/x.sock", {"bridge": None, "topic": "robot1"}),
        ("add --control /run/x.sock /scan transmit", {"bridge": None, "topic": "/scan"}),
        ("client add robot1 /etc/pc.yaml", {"bridge": None, "name": "robot1"}),
        ("fleet exec robot1 -- pause /scan", {"bridge": None, "names": ["robot1"]}),
    ],
)
def test_the_name_is_found(words: str, found: dict[str, Any]) -> None:
    assert {name: value for name, value in parsed(*words.split()).items() if name in found} == found


def test_a_mistyped_command_of_a_fleet_is_no_bridge(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parsed("fleet", "exce", "robot1")
    assert "exce" in capsys.readouterr().err


def test_each_command_that_attaches_has_the_option() -> None:
    parser, _ = parser_and_commands()
    without = set()
    for name, command in subcommands_of(parser).items():
        options = options_of(command)
        if any(each.dest == "control" for each in options) and not any("--bridge" in o.option_strings for o in options):
            without.add(name)
    assert without == {"run"}  # it starts one
