"""Limits on the width between a route and its half: the names that halves use, and the verbs that are empty."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

from tests.checks.class_bases import ROOT, body_of, classes_in, lineage, methods_of

ROUTE = ROOT / "bridge" / "rsb_bridge" / "route"
HALVES = {
    "Sender": ROUTE / "sender.py",
    "Receiver": ROUTE / "receiver.py",
    "Caller": ROUTE / "calls" / "caller.py",
    "Provider": ROUTE / "calls" / "provider.py",
}
MOST_NAMES = 40
MOST_EMPTY = 6


def _class(module: Path, name: str) -> ast.ClassDef:
    return next(each for each in classes_in(module) if each.name == name)


def _names_of_route(module: Path) -> set[str]:
    """Return what a module uses of a route, as `self.route.X` or `route.X`."""
    return {
        node.attr
        for statement in body_of(module)
        for node in ast.walk(statement)
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("self.route", "route")
    }


def _is_empty(method: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether a method is only a docstring, or does nothing else."""
    match method.body:
        case [ast.Expr(value=ast.Constant()) | ast.Pass() | ast.Return(value=None | ast.Constant(value=None))]:
            return True
        case [ast.Expr(value=ast.Constant()), ast.Pass() | ast.Return(value=None | ast.Constant(value=None))]:
            return True
    return False


def test_halves_use_few_names_of_their_route() -> None:
    modules = {*HALVES.values(), ROUTE / "calls" / "calls_half.py"}
    uses = Counter(name for module in modules for name in _names_of_route(module))
    assert {"id", "peer"} <= uses.keys()
    assert len(uses) <= MOST_NAMES, f"{len(uses)} names, with the modules that use each: {sorted(uses.items())}"


def test_few_verbs_of_halves_are_empty() -> None:
    """What one half alone needs is no verb of all."""
    verbs = methods_of(_class(ROUTE / "half.py", "Half")).keys()
    empty = set()
    for name, module in HALVES.items():
        classes = lineage(module, _class(module, name))
        for verb in verbs:
            made = next(((each, methods_of(each)[verb]) for each in classes if verb in methods_of(each)), None)
            if made is not None and _is_empty(made[1]):
                empty.add(f"{made[0].name}.{verb}")
    assert len(empty) <= MOST_EMPTY, sorted(empty)
