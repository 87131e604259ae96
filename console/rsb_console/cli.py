# PYTHON_ARGCOMPLETE_OK
"""The command `rsb-console`: from its start to its exit code, and how it reports an unexpected failure.

Imports are late here, so that an interrupt which comes while they run is met as quietly as any other.
"""

# ruff: noqa: PLC0415 (as above)

from __future__ import annotations

import os
import signal
import sys

from rsb_console.command.shell import (
    FAILURE,
    INTERRUPTED,
    OK,
    TERMINATED,
    USAGE,
    CleanErrors,
    CommandText,
    print_error,
    print_line,
)

TYPE_CHECKING = False  # without typing, which takes a while
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


_CRASHES = 1 << 20
"""Size in bytes at which crash.log is started again. A round figure: a few hundred tracebacks."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command. Afterwards SIGINT is ignored: the process should end.

    Args:
        argv: arguments, or None for the process's own.

    Returns:
        The exit code.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # the parent process closed it: discard the output
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115 -- as long as the process
    sys.stderr = CleanErrors(sys.stderr)
    signal.signal(signal.SIGTERM, _terminated)  # until the command handles it, which a bridge does once it is loaded
    if argv is None:
        _leave_ascii()
        _leave_working_folder()
    try:
        return _run(sys.argv[1:] if argv is None else list(argv))
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # one more would only end the interpreter's end in a traceback
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _leave_ascii() -> None:
    """Start again with UTF-8 where the locale has ASCII only, which can't open or print a path with an umlaut."""
    # Once: an option of the interpreter, -X utf8=0, counts for more than the variable.
    if sys.getfilesystemencoding() == "ascii" and os.environ.get("PYTHONUTF8") != "1":
        os.environ["PYTHONUTF8"] = "1"  # also of the processes that this one starts
        os.execv(sys.executable, [sys.executable, "-P", *sys.orig_argv[1:]])  # noqa: S606 -- this program


def _leave_working_folder() -> None:
    """Take the working folder off the path of modules, where an empty entry of PYTHONPATH or ``python -m`` puts it.

    In a folder that others write to, each command would run entry points of theirs as features.
    """
    try:
        here = os.path.realpath(os.getcwd())  # noqa: PTH109 -- without pathlib, which takes a while
    except OSError:  # it is removed
        here = ""

    def is_elsewhere(entry: str) -> bool:
        return bool(entry) and os.path.realpath(entry) != here

    # Behind Python's own modules there is what is installed, perhaps a checkout that is the working folder.
    library = os.path.dirname(os.__file__)  # noqa: PTH120
    before = sys.path.index(library) if library in sys.path else 0
    sys.path[:before] = filter(is_elsewhere, sys.path[:before])
    if variable := os.environ.get("PYTHONPATH"):  # of the processes that this one starts
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(is_elsewhere, variable.split(os.pathsep)))


def _terminated(*_: object) -> None:
    raise SystemExit(TERMINATED)


def _run(argv: list[str]) -> int:
    work, shows_failure = _asked_for(argv)
    try:
        code = work()
        # Here, where its errors are met: Python's own flush at exit would print a traceback and end with 120.
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of our output has gone (`| head`). Python's own flush at exit must not meet the pipe again.
        _mute()
        return FAILURE
    except Exception as error:  # noqa: BLE001 (the last resort: an operator gets a line, and where the rest is)
        if _is_full(error):
            _mute()
            why = getattr(error, "strerror", error)
            print_error(f"standard output: {why}: free space on its disk. The command's changes stay in effect")
            return FAILURE
        return _unexpected(error, show=shows_failure)
    return code


def _asked_for(argv: list[str]) -> tuple[Callable[[], int], bool]:
    """Return what the arguments ask for, and whether to show a failure's traceback."""
    if next((word for word in argv if word != "--debug"), "") == "--version":
        # Scripts ask for it: the arguments of all commands would take three times as long.
        return _print_version, "--debug" in argv
    from functools import partial

    from rsb_console.command.arguments import parser_and_commands

    parser, names = parser_and_commands()
    if "_ARGCOMPLETE" in os.environ:
        from rsb_console.command.completion import complete

        complete(parser, names)
    arguments = parser.parse_args(_with_command(argv, names))
    return partial(arguments.command, arguments), "debug" in arguments


def _print_version() -> int:
    from importlib.metadata import version

    print_line(f"rsb-console {version('rsb-console')}")
    return OK


def _is_full(error: Exception) -> bool:
    """Whether the error means that standard output is redirected to a full disk; no named file is involved."""
    from rsb_bridge.config.files import SHORTAGES

    return isinstance(error, OSError) and error.errno in SHORTAGES and error.filename is None


def _mute() -> None:
    """Discard the rest of standard output."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _with_command(argv: list[str], names: Sequence[str]) -> list[str]:
    """Insert `run` if the arguments do not begin with a command."""
    from difflib import get_close_matches

    from rsb_bridge.feature import BRINGS_COMMANDS

    # `rsb-console --debug` alone opens the console.
    first = next((argument for argument in argv if argument != "--debug"), None)
    if first is None:
        return ["run", *argv]
    if first in (*names, "-h", "--help"):
        return argv
    if os.path.exists(first):  # noqa: PTH110 -- never raises, unlike Path.exists
        return ["run", *argv]
    if first in BRINGS_COMMANDS:
        print_error(CommandText.OF_FEATURE(word=first, feature=BRINGS_COMMANDS[first]))
        raise SystemExit(USAGE)
    if meant := get_close_matches(first, names, n=1, cutoff=0.75):
        print_error(CommandText.MISSPELT(word=first, command=meant[0]))
        raise SystemExit(USAGE)
    return ["run", *argv]


def _unexpected(error: Exception, *, show: bool) -> int:
    """Report an unexpected error in a line, and keep the traceback in crash.log."""
    import traceback

    if show:
        traceback.print_exception(error)
        return FAILURE
    from platformdirs import user_state_path

    from rsb_bridge.config.files import make_folder, owner_only, why_not_written
    from rsb_bridge.model.text import several_lines

    log = user_state_path("rsb-console") / "crash.log"
    message = f"unexpected {type(error).__name__}: {error}".splitlines()[0]
    try:
        make_folder(log.parent)
        mode = "a" if log.exists() and log.stat().st_size < _CRASHES else "w"
        with open(log, mode, encoding="utf-8", opener=owner_only) as file:
            file.writelines(map(several_lines, traceback.format_exception(error)))
    except OSError as full:
        print_error(CommandText.CRASHED_WITHOUT_LOG(problem=message, log=log, reason=why_not_written(full, log)))
    else:
        print_error(f"{message} (details: {log})")
    return FAILURE


if __name__ == "__main__":
    sys.exit(main())
