"""Limits on private members of others: each breaks a module or a test when its owner renames it."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from tests.checks.class_bases import ROOT

if TYPE_CHECKING:
    from collections.abc import Iterator

MOST = 96
PUBLIC = {
    "_replace",
    "_asdict",
    "_fields",
    "_make",
    "_exit",
    "_get_running_loop",
    "_set_running_loop",
    "_value_",
    "_fields_",
}
"""Of named tuples, `os`, asyncio, enumerations and ctypes."""
OVERRIDDEN = {"_missing_"}
"""Of enumerations, for their subclasses."""
OWN = {"self", "cls", "super()"}
COLLECTED = ("rsb_bridge.ros.", "rsb_bridge.python_internals.", "rsb_console.library_internals.")
"""Packages for private parts of libraries: those of ROS are in `rsb_bridge.ros.native`, and found out at start."""
PACKAGES = ("bridge/rsb_bridge", "console/rsb_console", "extras/rsb_extras")
PROJECT = ("rsb_bridge", "rsb_console", "rsb_extras")


def private(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8")
    if {*re.findall(r"(?<!\bself)(?<!\bcls)\.(_[A-Za-z]\w*)", text)} <= PUBLIC:
        return []  # to parse all takes seconds
    nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)]
    hidden = [each for each in nodes if is_private(each.attr) and each.attr not in PUBLIC]
    return [f"{path}:{each.lineno} {each.attr}" for each in hidden if ast.unparse(each.value) not in OWN]


def is_private(name: str) -> bool:
    return name.startswith("_") and name[:2] != "__"


def test_tests_name_few_private_members_of_others() -> None:
    paths = [*(ROOT / "tests").rglob("*.py"), *ROOT.glob("extras/rsb_extras/*/tests/*.py")]
    found = [place for path in sorted(paths) for place in private(path)]
    assert len(found) <= MOST, "\n".join(found)


def modules() -> Iterator[tuple[str, Path]]:
    """Yield the program's modules with their files, but those that collect private parts, and programs to run."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = ".".join(path.relative_to((ROOT / package).parent).with_suffix("").parts).removesuffix(".__init__")
            if not ({"tests", "docs", "__main__"} & {*name.split(".")} or name.startswith(COLLECTED)):
                yield name, path


def imported(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the private modules and names that a module imports of others, with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            names = (*(node.module or "").split("."), *(each.name for each in node.names))
        elif isinstance(node, ast.Import):
            names = tuple(part for each in node.names for part in each.name.split("."))
        else:
            continue
        yield from ((node.lineno, name) for name in names if is_private(name) and name != "_typeshed")  # has no code


@cache
def defined(folder: Path) -> set[str]:
    """Return the private names that a folder's modules give to functions and attributes."""
    return {
        name
        for path in folder.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for name in (getattr(node, "name", ""), getattr(getattr(node, "target", None), "id", ""), assigned(node))
        if name
    }


def assigned(node: ast.AST) -> str:
    return node.attr if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and is_own(node) else ""


def is_own(node: ast.Attribute) -> bool:
    return ast.unparse(node.value) in OWN


@cache
def inside(library_class: type) -> set[str]:
    """Return the private names of a library's class: its members, and what its source gives to its objects."""
    names = {name for name in vars(library_class) if is_private(name)}
    try:
        source = inspect.getsource(library_class)
    except (OSError, TypeError):  # of C
        return names
    return names | {*re.findall(r"\bself\.(_[a-z]\w*)\s*(?::[^=\n]+)?=[^=]", source)}


def inherited(module: str, tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the private names of libraries' classes that subclasses of these use or replace, with their lines."""
    for node in (each for each in ast.walk(tree) if isinstance(each, ast.ClassDef) and each.bases):
        found = getattr(importlib.import_module(module), node.name, None)
        bases = found.__mro__[:-1] if isinstance(found, type) else ()
        others = [each for each in bases if each.__module__.partition(".")[0] not in PROJECT]
        names = {name for each in others for name in inside(each)} - OVERRIDDEN
        if not names:
            continue
        for each in ast.walk(node):
            name = each.attr if isinstance(each, ast.Attribute) and is_own(each) else getattr(each, "name", None)
            if name in names:
                yield getattr(each, "lineno", node.lineno), name


def test_private_parts_of_libraries_are_collected() -> None:
    """Other modules use no private member of a library, also by chance: an attribute of one's own may be its, too."""
    found = []
    for module, path in modules():
        text = path.read_text(encoding="utf-8")
        if not re.search(r"\b_[A-Za-z]", text):
            continue
        tree = ast.parse(text)
        own = defined(path.parent)
        others = [place for place in private(path) if place.rpartition(" ")[2] not in own]
        taken = [f"{path}:{line} {name}" for line, name in (*imported(tree), *inherited(module, tree))]
        found += sorted({*others, *taken})
    assert not found, "\n".join(found)
