"""The words of a command: a bridge's name, as an option or as a plain word, and options wherever they stand."""

from __future__ import annotations

from pathlib import Path
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
        ("param --bridge pc list /node", {"bridge": "pc", "node": "/node"}),
        ("param list --bridge pc /node", {"bridge": "pc", "node": "/node"}),
        ("param pc list /node --json", {"bridge": "pc", "node": "/node", "json": True}),
        ("param --control x.sock --json get /node speed", {"control": Path("x.sock"), "json": True, "bridge": None}),
        ("param list pc", {"bridge": "pc", "node": None}),
        ("param get node speed", {"bridge": None, "node": "node"}),
        ("param get pc /node speed", {"bridge": "pc", "node": "/node", "names": ["speed"]}),
        ("wait pc --for flowing /scan", {"bridge": "pc", "wanted": ["flowing", "/scan"]}),
        ("wait --for linked --bridge pc", {"bridge": "pc", "wanted": ["linked"]}),
        ("bench pc", {"bridge": "pc"}),
        ("bench --bridge pc", {"bridge": "pc"}),
        # no bridge
        ("pause /scan", {"bridge": None, "topic": "/scan"}),
        ("pause scan", {"bridge": None, "topic": "scan"}),
        ("ack robot1 --control /run/x.sock", {"bridge": None, "topic": "robot1"}),
        ("add --control /run/x.sock /scan transmit", {"bridge": None, "topic": "/scan"}),
        ("client add /etc/pc.yaml robot1", {"bridge": None, "name": "robot1"}),
        ("fleet exec robot1 -- pause /scan", {"bridge": None, "names": ["robot1"]}),
        # options stand anywhere
        ("client add pc.yaml --prefix robot2", {"name": "robot2", "use_name": True, "session": Path("pc.yaml")}),
        ("client add --prefix pc.yaml robot2", {"name": "robot2", "use_name": True, "session": Path("pc.yaml")}),
        ("client add pc.yaml robot2 --prefix", {"name": "robot2", "use_name": True, "session": Path("pc.yaml")}),
        ("client add robot2", {"name": "robot2", "use_name": None, "session": None}),
        ("add /scan --link a transmit qos=1 --json depth=2", {"direction": "transmit", "keys": ["qos=1", "depth=2"]}),
        ("add --service /dock --provider client", {"topic": "/dock", "kind": "service", "keys": [], "direction": None}),
        ("call --json /dock --link a {a:1}", {"topic": "/dock", "link": "a", "request": "{a:1}"}),
        ("param set /node --json speed -5", {"node": "/node", "pairs": ["speed", "-5"]}),
        ("param set /node speed -- -x", {"pairs": ["speed", "-x"]}),
        ("status --json robot1", {"bridge": "robot1", "json": True}),
        ("status --bridge robot1", {"bridge": "robot1"}),
        ("status", {"bridge": None}),
        ("keygen --force", {"path": Path("key.txt"), "force": True}),
        ("wait --for flowing /scan --timeout 3", {"wanted": ["flowing", "/scan"], "timeout": 3.0}),
        ("run --no-ui a.yaml --debug", {"session": Path("a.yaml"), "debug": True}),
    ],
)
def test_what_words_say_is_found_wherever_options_stand(words: str, found: dict[str, Any]) -> None:
    assert {name: value for name, value in parsed(*words.split()).items() if name in found} == found


@pytest.mark.parametrize(
    "words",
    [
        "fleet exce robot1",  # no bridge
        *("status a b", "client add a b c", "remove /scan --what", "param get /node", "wait"),
        *(f"demo --fleet --robots {count}" for count in ("0", "-1", "many")),
        *(f"hz /scan --window={window}" for window in ("0", "121", "1.5", "x", "-1", "9" * 5000)),
    ],
)
def test_what_no_command_takes_is_refused(words: str) -> None:
    with pytest.raises(SystemExit) as caught:
        parsed(*words.split())
    assert caught.value.code == 2


def test_each_command_that_attaches_has_the_option() -> None:
    parser, _ = parser_and_commands()
    without = set()
    for name, command in subcommands_of(parser).items():
        options = options_of(command)
        if any(each.dest == "control" for each in options) and not any("--bridge" in o.option_strings for o in options):
            without.add(name)
    assert without == {"run"}  # it starts one
