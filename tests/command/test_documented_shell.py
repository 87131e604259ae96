"""The shell lines of the documents, apart from `rsb-console`: the names in them exist in the project."""

from __future__ import annotations

import re
import shlex
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from rsb_bridge.feature import BRINGS

_ROOT = Path(__file__).parents[2]
_DOCS = [*_ROOT.glob("docs/*.md"), *_ROOT.glob("extras/rsb_extras/*/docs/*.md")]
_PAGES = [*_ROOT.glob("*.md"), *_DOCS, _ROOT / "bench" / "README.md", _ROOT / "tests" / "README.md"]
_TEXTS = {str(page.relative_to(_ROOT)): page.read_text(encoding="utf-8") for page in sorted(_PAGES)}
_OWN = {"make", "python", "python3", "pip", "pipx"}
"""Programs whose arguments name targets, modules and files of the project: the tests below look for them."""
_OTHERS = {
    "curl": "asks a running bridge, as the exporters' tests do",
    "echo": "writes the kernel's settings",
    "export": "sets the shell",
    "ros2": "needs the package installed; tests/config/test_ros_package.py looks for its parts",
    "rsb-console": "tests/command/test_documented_commands.py runs it",
    "scp": "needs another machine",
    "source": "sets the shell",
    "sudo": "changes the kernel's settings",
    "zenohd": "is Zenoh's own router; extras/rsb_extras/zenoh/tests/zenoh_router.py replaces it",
}
"""Other programs, and why nothing here runs or checks their lines."""
_OF_FEATURES = {"curl", "zenohd"}
_PROGRAMS = _OWN | set(_OTHERS)


def blocks(language: str) -> Iterator[tuple[str, str]]:
    for page, text in _TEXTS.items():
        for indent, found, block in re.findall(r"^( *)```(\w*)\n(.*?)^ *```$", text, re.MULTILINE | re.DOTALL):
            if found == language:
                yield page, re.sub(f"^{indent}", "", block, flags=re.MULTILINE)


def shell_lines() -> Iterator[tuple[str, list[str]]]:
    """The words of each line; where a block has prompts, of the lines with one. A block may show an output instead."""
    for page, block in blocks(""):
        typed = re.findall(r"^\$ (.*)", block, re.MULTILINE) or block.splitlines()
        if program(typed[0].split()) in _PROGRAMS:
            lines = [shlex.split(re.sub(r"^\w+=\$\((.*)\)$", r"\1", line), comments=True) for line in typed]
            yield from ((page, words) for words in lines if words)


def program(words: list[str]) -> str:
    return Path(re.sub(r"^\w+=\$\(", "", words[0])).name


LINES = [*shell_lines()]


def named(pattern: str) -> set[str]:
    codes = [code for text in _TEXTS.values() for code in re.findall(r"`([^`\n]+)`", text)]
    lines = [" ".join(words) for _, words in LINES]
    return {name for text in (*codes, *lines) for name in re.findall(pattern, text)}


def test_every_program_is_checked_or_excused() -> None:
    found = {program(words) for _, words in LINES}
    assert found <= _PROGRAMS
    assert _PROGRAMS - found <= _OF_FEATURES, "which the core alone does not have"
    tests = re.findall(r"[\w/]*tests/\S+\.py", " ".join(_OTHERS[each] for each in found & set(_OTHERS)))
    assert [name for name in tests if not (_ROOT / name).is_file()] == []


def test_targets_of_make_exist() -> None:
    makefile = (_ROOT / "Makefile").read_text(encoding="utf-8")
    targets = {name for names in re.findall(r"^([\w -]+):", makefile, re.MULTILINE) for name in names.split()}
    folders = {f"test-{folder.name}" for folder in (_ROOT / "tests").iterdir() if [*folder.glob("test_*.py")]}
    features = {f"test-{name}" for name in BRINGS.values()}
    found = named(r"^make ([\w-]+)")
    assert len(found) > 10
    assert found <= targets | folders | features


def test_modules_exist() -> None:
    found = named(r"python3? -m ([\w.]+)") - {"pytest", "venv"}
    assert len(found) > 5
    for name in found:
        places = [_ROOT / part / name.replace(".", "/") for part in ("", "bridge", "console", "extras")]
        assert any(place.with_suffix(".py").is_file() or (place / "__main__.py").is_file() for place in places), name


def test_files_exist() -> None:
    found = named(r"(?:^|[ `])((?:bench|configs|docs|locks|tests)/[\w./@-]+\.\w+)")
    assert len(found) > 10
    assert [name for name in found if not (_ROOT / name).exists()] == []


def test_extras_exist() -> None:
    extras = tomllib.loads((_ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    found = {name for names in named(r"\.\[([\w,-]+)\]") for name in names.split(",")}
    assert found
    assert found <= extras.keys()


@pytest.mark.parametrize(("page", "script"), [*blocks("sh")])
def test_a_shell_takes_the_scripts(page: str, script: str) -> None:
    run = subprocess.run(["sh", "-n"], input=script, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (0, ""), page
