"""``python -m tests.fuzz``: fuzzes every parser, or repeats its findings (tests/README.md)."""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz.findings import inputs_in
from tests.fuzz.parsers import load_parsers

FOLDER = Path(__file__).parents[2] / "build" / "fuzz"
_STATISTIC = re.compile(r"^stat::number_of_executed_units: +(\d+)$", re.MULTILINE)


@dataclass(frozen=True)
class Outcome:
    """The result of one parser.

    Attributes:
        executions: inputs that it read, or None if its process failed.
    """

    name: str
    executions: int | None
    seconds: float
    output: str


def main() -> int:
    arguments = _arguments()
    if arguments.inputs:
        for path in arguments.inputs:
            _show(path)
        return 0
    if importlib.util.find_spec("atheris") is None:
        _say("atheris is not installed; for fuzzing, run: .venv/bin/pip install -e '.[fuzz]'")
        return 2
    return _fuzz(arguments.only or list(load_parsers()), arguments.seconds, arguments.jobs)


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("inputs", nargs="*", type=Path, help="files that were found: read each of them again")
    parser.add_argument("--seconds", type=float, default=300.0, help="for all parsers together (300)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes at a time (one a core)")
    parser.add_argument("--only", action="append", metavar="PARSER", choices=sorted(load_parsers()))
    return parser.parse_args()


def _show(path: Path) -> None:
    """Have the parser that a file's name begins with read it; what is wrong is raised."""
    parsers = load_parsers()
    parser = parsers.get(path.parent.name) or parsers[path.name.partition("-")[0]]
    parser.read(path.read_bytes())
    _say(f"{path}: {parser.name} reads it as it should")


def _fuzz(names: list[str], seconds: float, jobs: int) -> int:
    """Fuzz these parsers, `jobs` at a time, within so many s. Returns the exit code."""
    each = max(1.0, seconds * min(jobs, len(names)) / len(names))
    known = set(inputs_in(FOLDER / "findings"))
    (FOLDER / "findings").mkdir(parents=True, exist_ok=True)
    total, failed = 0, False
    _say(f"{'parser':24}{'executions':>12}{'a second':>10}{'corpus':>8}{'findings':>10}")
    with tempfile.TemporaryDirectory(prefix="rsb-fuzz-") as scratch, ThreadPoolExecutor(jobs) as pool:
        for outcome in pool.map(lambda name: _run(name, each, scratch), names):
            found = [path for path in inputs_in(FOLDER / "findings") if path.name.startswith(f"{outcome.name}-")]
            corpus = len(list((FOLDER / "corpus" / outcome.name).glob("*")))
            rate = (outcome.executions or 0) / outcome.seconds
            _say(f"{outcome.name:24}{outcome.executions or 0:>12,}{rate:>10,.0f}{corpus:>8}{len(found):>10}")
            for path in found:
                _say(f"    {path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path}"
                      f"{'' if path not in known else ' (of an earlier run)'}")  # fmt: skip
            if outcome.executions is None:
                _say(outcome.output[-2000:])
            failed |= bool(found) or outcome.executions is None
            total += outcome.executions or 0
    _say(f"{'all':24}{total:>12,}")
    if failed:
        _say("read a finding again, and see what is wrong with it: .venv/bin/python -m tests.fuzz FILE")
    return 1 if failed else 0


def _run(name: str, seconds: float, scratch: str) -> Outcome:
    command = [sys.executable, "-m", "tests.fuzz.coverage", name, str(round(seconds)), str(FOLDER)]
    began = time.monotonic()
    done = subprocess.run(
        command, capture_output=True, text=True, errors="replace", check=False, env={**os.environ, "TMPDIR": scratch}
    )
    output = done.stdout + done.stderr
    counted = _STATISTIC.search(output)
    return Outcome(name, int(counted[1]) if counted else None, max(0.1, time.monotonic() - began), output)


if __name__ == "__main__":
    sys.exit(main())
