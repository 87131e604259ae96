"""Session files to put a mistake into, and the mistakes that are found in them."""

from pathlib import Path
from typing import Any

import pytest
from tests.support.wording import says

from rsb_bridge.config.session_file import SessionError, parse
from rsb_bridge.model.session import Problem
from rsb_bridge.model.wording import Wording

FILE = Path("robot1.yaml")
CLIENT = "name: robot1\nrole: client\nserver_ip: 192.168.1.10\nserver_port: 49152\nkey_file: key.txt\n"
SERVER = "name: control\nrole: server\nserver_ip: 0.0.0.0\nserver_port: 49152\nkey_file: key.txt\n"
BLUETOOTH = "name: robot1\nrole: client\nserver_ip: 5C:F3:70:9A:1B:2E\nserver_port: 5\nkey_file: key.txt\n"


def problems(text: str) -> tuple[Problem, ...]:
    with pytest.raises(SessionError) as caught:
        parse(text, FILE)
    return caught.value.problems


def has(problem: Problem, line: int | None, location: str, code: Wording, parameters: dict[str, Any]) -> bool:
    return (problem.line, problem.location) == (line, location) and says(problem.message, code, **parameters)
