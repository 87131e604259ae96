"""A process that answers each line of its standard input with one, both JSON."""

from __future__ import annotations

import json
import select
import sys
from collections.abc import Callable
from typing import Any

_ANSWERS_WITHIN = 180.0


class Asked:
    """The other end of such a process.

    Args:
        process: started with pipes for text.
    """

    def __init__(self, process: Any) -> None:
        self._process = process

    def ask(self, **request: Any) -> Any:
        """Return the answer to a request."""
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answers = self._process.stdout
        assert select.select([answers], [], [], _ANSWERS_WITHIN)[0], f"it does not answer {request}"
        answer = json.loads(answers.readline())
        assert "broken" not in answer, answer
        return answer["is"]

    def close(self) -> None:
        with self._process:
            self._process.kill()


def answers(act: Callable[[dict[str, Any]], object], within: float) -> bool:
    """Answer a request if one comes within so many seconds; return False once the input has ended."""
    if select.select([sys.stdin], [], [], within)[0]:
        line = sys.stdin.readline()
        if not line:
            return False
        try:
            answer = {"is": act(json.loads(line))}
        except ValueError as error:
            answer = {"broken": str(error)}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()
    return True
