"""Forks `rsb-console run` for `tests.support.program`: a line of standard input each, their pids on standard output."""

from __future__ import annotations

import importlib
import json
import os
import resource
import signal
import sys


def main() -> int:
    """Fork until the input ends."""
    for module in ("rsb_console.cli", "rsb_console.command.headless", "rsb_bridge.ros.participant", "std_msgs.msg"):
        importlib.import_module(module)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # no zombies
    print("ready", flush=True)  # noqa: T201
    for line in sys.stdin:
        session, log, descriptors = json.loads(line)
        pid = os.fork()
        if not pid:
            if descriptors:
                resource.setrlimit(resource.RLIMIT_NOFILE, tuple(descriptors))
            os._exit(run(session, log))
        print(pid, flush=True)  # noqa: T201
    return 0


def run(session: str, log: str) -> int:
    """Be the program."""
    from rsb_console.cli import main as rsb_console

    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    for stream in (1, 2):
        os.dup2(output, stream)
    # A socket of its own: some tests run one session twice, as two machines may.
    code = rsb_console(["run", session, "--no-ui", "--log-format", "json", "--control", f"{session}.sock"])
    sys.stdout.flush()
    return code


if __name__ == "__main__":
    sys.exit(main())
