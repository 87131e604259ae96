"""Classes of the program with their bases, as their source says: nothing is imported."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PARTS = ("bridge", "console", "extras")
_OF_LIBRARIES = {"library_internals", "python_internals"}
"""Folders whose classes stand for a library's."""
Method = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def body_of(module: Path) -> list[ast.stmt]:
    return ast.parse(module.read_text(encoding="utf-8")).body


@cache
def _modules_by_class() -> dict[str, list[Path]]:
    """Return the modules that define a class of a name. To parse all of them takes seconds."""
    found: dict[str, list[Path]] = defaultdict(list)
    for part in PARTS:
        for module in (ROOT / part).rglob("*.py"):
            if _OF_LIBRARIES & {*module.parts}:
                continue
            for name in re.findall(r"^class (\w+)", module.read_text(encoding="utf-8"), re.MULTILINE):
                found[name].append(module)
    return found


def classes_in(module: Path) -> list[ast.ClassDef]:
    return [each for each in ast.walk(ast.Module(body_of(module), [])) if isinstance(each, ast.ClassDef)]


def lineage(module: Path, node: ast.ClassDef) -> list[ast.ClassDef]:
    """Return a class and all its bases in the project, each after the classes that it is a base of."""
    found = [node]
    for base in node.bases:
        name = _name_of(base)
        modules = _modules_by_class().get(name, [])
        where = module if module in modules else next(iter(modules), None)
        if where is not None:
            above = next(each for each in classes_in(where) if each.name == name)
            found += [each for each in lineage(where, above) if each not in found]
    return found


def _name_of(base: ast.expr) -> str:
    if isinstance(base, ast.Subscript):
        return _name_of(base.value)
    return base.attr if isinstance(base, ast.Attribute) else base.id if isinstance(base, ast.Name) else ""


def methods_of(node: ast.ClassDef) -> dict[str, Method]:
    """Return a class's own methods and properties by their names."""
    return {each.name: each for each in node.body if isinstance(each, Method)}


def is_special(name: str) -> bool:
    return name.startswith("__") and name.endswith("__")
