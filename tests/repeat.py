"""Runs the whole suite several times from a clean clone, and lists what failed how often (tests/README.md).

``python -m tests.repeat 10``, or ``python -m tests.repeat 3 --core 0 --busy`` for one core that is shared with a loop
that never waits. With ``--stall 1.2``, processes of the tests stand still now and then, as they do on a machine that
others use, too.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import re
import resource
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[1]
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+::.+?|\S+)(?: - .*)?$", re.MULTILINE)
_COUNTS = re.compile(r"^=+ (.*\b(?:passed|failed|error)\b.*?) =+$", re.MULTILINE)


def main() -> int:
    """Return 1 if a run has failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.repeat", description=__doc__)
    parser.add_argument("times", type=int, metavar="N")
    parser.add_argument("--core", type=int, help="run on this core alone")
    parser.add_argument("--busy", action="store_true", help="with a busy loop on each core")
    parser.add_argument("--stall", type=float, default=0.0, metavar="SECONDS", help="stop a process now and then")
    parser.add_argument("--only", metavar="ARGUMENTS", help="what to run, as pytest's arguments: 'tests/route -k rest'")
    arguments = parser.parse_args()
    if arguments.core is not None:
        os.sched_setaffinity(0, {arguments.core})
    folder = ROOT / "build" / "repeat"
    clone = folder / "clone"
    run("rm", "-rf", str(folder))
    run("git", "clone", "--quiet", str(ROOT), str(clone))
    run("make", "--directory", str(clone), ".venv/.installed", f"PYTHON={sys.executable}")
    make = ["make", "test", "NET=", f"PYTHON={sys.executable}", *([f"ALL={arguments.only}"] if arguments.only else ())]
    say(f"{shlex.join(make)}, {arguments.times} times, at {git(clone, 'rev-parse', '--short', 'HEAD')}")
    failures: Counter[str] = Counter()
    with busy_loops(arguments.busy), stalls(arguments.stall):
        for number in range(1, arguments.times + 1):
            git(clone, "clean", "-ffdxq", "--exclude=.venv")
            failures.update(run_once(make, clone, folder / f"{number}.log", number))
    for test, count in failures.most_common():
        say(f"{count} of {arguments.times}  {test}")
    say("no failure" if not failures else f"the outputs: {folder}/*.log")
    return bool(failures)


def run_once(make: list[str], clone: Path, log: Path, number: int) -> set[str]:
    """Run the suite, and return the tests that failed."""
    began, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    with log.open("w") as file:
        code = subprocess.run(make, cwd=clone, stdout=file, stderr=subprocess.STDOUT, check=False).returncode
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    output = log.read_text()
    found = set(_FAILED.findall(output)) or ({f"make ended with {code}, see {log}"} if code else set())
    counts = _COUNTS.findall(output)[-1:] or ["no summary"]
    user, system = after.ru_utime - before.ru_utime, after.ru_stime - before.ru_stime
    say(f"{number}: {counts[0]}; {time.monotonic() - began:.0f} s, {user:.0f} s user, {system:.0f} s system")
    for test in sorted(found):
        say(f"   {test}")
    return found


@contextlib.contextmanager
def busy_loops(wanted: bool) -> Iterator[None]:
    """Have each core that this process may use also run a loop that never waits."""
    loops = []
    try:
        for core in os.sched_getaffinity(0) if wanted else ():
            code = f"import os\nos.sched_setaffinity(0, {{{core}}})\nwhile True: pass"
            loops.append(subprocess.Popen([sys.executable, "-c", code]))
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


@contextlib.contextmanager
def stalls(seconds: float) -> Iterator[None]:
    """Stop one of the Python processes that this one has started, by chance, for so long (s), again and again."""
    over = threading.Event()

    def stop_some() -> None:
        while not over.wait(random.uniform(2.0, 6.0)):
            if found := _running_pythons():
                stopped = random.choice(found)
                with contextlib.suppress(ProcessLookupError):
                    os.kill(stopped, signal.SIGSTOP)
                    over.wait(seconds)
                    os.kill(stopped, signal.SIGCONT)

    thread = threading.Thread(target=stop_some)
    if seconds:
        thread.start()
    try:
        yield
    finally:
        over.set()
        if seconds:
            thread.join()


def _running_pythons() -> list[int]:
    """Return the ids of the Python processes below this one that are not stopped, as a debugger stops some of them."""
    children: dict[int, list[int]] = {}
    found, programs = list[int](), {Path(sys.executable).resolve().name, "python"}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            pid, _, rest = stat.read_text().partition(" (")
            name, _, rest = rest.rpartition(") ")
            state, parent, *_ = rest.split()
            children.setdefault(int(parent), []).append(int(pid))
            if name in programs and state not in "TtZ":
                found.append(int(pid))
    below, new = set[int](), children.get(os.getpid(), [])
    while new:
        below.update(new)
        new = [child for each in new for child in children.get(each, [])]
    return [each for each in found if each in below]


def git(clone: Path, *arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=clone, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


def run(*command: str) -> None:
    subprocess.run(command, check=True)


def say(text: str) -> None:
    print(text, flush=True)  # noqa: T201


if __name__ == "__main__":
    sys.exit(main())
