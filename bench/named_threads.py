"""``python -m bench.named_threads ARGUMENTS`` is `rsb-console`, whose threads the kernel knows by Python's names."""

from __future__ import annotations

import sys
import threading

_NAME_LENGTH = 15  # the kernel keeps no more, proc_pid_comm(5)
_run = threading.Thread.run


def name_threads() -> None:
    """Have the kernel know this process's threads, from now on, by Python's names."""
    threading.Thread.run = _run_named  # type: ignore[assignment,method-assign]


def _run_named(thread: threading.Thread) -> None:
    with open(f"/proc/self/task/{threading.get_native_id()}/comm", "w", encoding="ascii") as name:  # noqa: PTH123
        name.write(thread.name[:_NAME_LENGTH])
    _run(thread)


if __name__ == "__main__":
    from rsb_console.cli import main

    name_threads()
    sys.exit(main())
