"""Names in docs/architecture.md exist in the program, and the page has every package, in the order of its layers.

No two modules, and no two public classes, have the same name.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest

_ROOT = Path(__file__).parents[2]
_PACKAGES = (_ROOT / "bridge" / "rsb_bridge", _ROOT / "console" / "rsb_console", _ROOT / "extras" / "rsb_extras")
_PAGE = (_ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
_TEXT = re.sub(r"^```.*?^```", "", _PAGE, flags=re.MULTILINE | re.DOTALL)
"""The page without its picture."""
_LIBRARY = frozenset({"asyncio.to_thread"})
_EXAMPLES = frozenset({"a.b.C.d", "bridge/rsb_bridge/a/b.py", "console/rsb_console/a/b.py"})
_NAMES = sorted({name for name in re.findall(r"`([^`\s]+)`", _TEXT) if "." in name or "/" in name} - _EXAMPLES)


def is_file(name: str) -> bool:
    """Whether a path is in the project, from its root or from one of its two programs."""
    return any((folder / name).exists() for folder in (_ROOT, *_PACKAGES))


def is_named(name: str) -> bool:
    """Whether a dotted name is a package, a module, or something that a module or a class of it defines."""
    parts = name.split(".")
    for folder in _PACKAGES:
        for length in range(len(parts), 0, -1):
            place = folder.joinpath(*parts[:length])
            if place.is_dir() and length == len(parts):
                return True
            if place.with_suffix(".py").is_file():
                return defines(place.with_suffix(".py"), tuple(parts[length:]))
    return False


def defines(module: Path, names: tuple[str, ...]) -> bool:
    """Whether a module has a name, or a class of it a method."""
    body = _body(module)
    for name in names:
        found = next((each for each in body if name in _names_of(each)), None)
        if found is None:
            return False
        body = found.body if isinstance(found, ast.ClassDef) else []
    return True


@cache
def _body(module: Path) -> list[ast.stmt]:
    return ast.parse(module.read_text(encoding="utf-8")).body


def _names_of(statement: ast.stmt) -> set[str]:
    match statement:
        case ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef():
            return {statement.name}
        case ast.Assign(targets=targets):
            return {each.id for each in targets if isinstance(each, ast.Name)}
        case ast.AnnAssign(target=ast.Name(id=name)):
            return {name}
    return set()


def test_what_the_page_names_exists() -> None:
    names = [name for name in _NAMES if not name.startswith("/") and name not in _LIBRARY]  # no topics
    assert len(names) > 100
    assert [name for name in names if not is_named(name) and not is_file(name)] == []


@pytest.mark.parametrize("package", ["rsb_bridge", "rsb_console"])
def test_the_layers_are_those_of_the_contracts(package: str) -> None:
    settings = tomllib.loads((_ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    layers = next(each["layers"] for each in contracts if each.get("containers") == [package])
    table = _TEXT.partition(f"\n| `{package}` | |\n")[2].partition("\n\n")[0]
    shown = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
    for layer in layers:
        peers = layer.split(" | ")
        assert sorted(shown[: len(peers)]) == sorted(peers)
        shown = shown[len(peers) :]
    assert not shown


def test_every_package_is_named() -> None:
    """Packages within packages, too; the picture or the text has them all."""
    named = set(re.findall(r"`([\w.]+)`", _TEXT))
    packages = {
        ".".join(each.parent.relative_to(folder).parts) for folder in _PACKAGES for each in folder.rglob("__init__.py")
    } - {""}
    assert packages <= named


def test_every_thread_is_one_that_the_program_starts() -> None:
    table = _TEXT.partition("\n| thread |")[2].partition("\n\n")[0]
    names = [name for row in table.splitlines()[2:] for name in re.findall(r"`([\w-]+)`", row.split("|")[1])]
    sources = "\n".join(each.read_text(encoding="utf-8") for folder in _PACKAGES for each in folder.rglob("*.py"))
    assert names
    assert [name for name in names if re.search(f'(name(_prefix)?=|in_thread\\()"{name}"', sources) is None] == []


def test_names_of_modules_and_public_classes_are_unique() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for package in _PACKAGES:
        for module in package.rglob("*.py"):
            where = str(module.relative_to(package.parent))
            if "tests" in module.parts[len(package.parts) :]:
                continue
            if not module.name.startswith("__"):
                places[module.name].append(where)
            for each in _body(module):
                if isinstance(each, ast.ClassDef) and not each.name.startswith("_"):
                    places[each.name].append(where)
    assert {name: found for name, found in places.items() if len(found) > 1} == {}
