"""No code of the program decides by a sentence: sentences are for people, and codes are compared."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
OF_OTHERS = {
    "bridge/rsb_bridge/config/yaml_text.py": (
        "mapping values",
        "while parsing a flow",
        "simple key",
        "quoted scalar",
    ),
    "bridge/rsb_bridge/ros/native/rclpy_extension.py": (", at ",),
    "extras/rsb_extras/bench/loopback.py": ("model name",),
    "extras/rsb_extras/zenoh/unreachable.py": ("Unable to connect", " at /"),
}
"""Words of other programs, which have no codes, by the module that looks for them."""
OF_FILES = {
    "extras/rsb_extras/fleet/simulated_fleet.py": ("listening on",),
    "extras/rsb_extras/service/systemd_service.py": ("# Written by",),
    "console/rsb_console/command/call_command.py": ("# goal_id: ",),
}
"""Words of this program that come back from a file or a terminal."""
SEARCHES = {
    "startswith",
    "endswith",
    "partition",
    "rpartition",
    "split",
    "removeprefix",
    "removesuffix",
    "find",
    "index",
}


def test_no_sentence_is_compared() -> None:
    paths = [path.relative_to(ROOT) for part in ("bridge", "console", "extras") for path in (ROOT / part).rglob("*.py")]
    program = [path for path in paths if not {"docs", "tests"} & {*path.parts}]
    trees = {str(path): ast.parse((ROOT / path).read_text(encoding="utf-8")) for path in program}
    sentences = {name: dict(_constants(tree)) for name, tree in trees.items()}
    by_module = {name.partition("/")[2].removesuffix(".py").replace("/", "."): name for name in trees}
    wordings = {
        each.name
        for tree in trees.values()
        for each in tree.body
        if isinstance(each, ast.ClassDef)
        and any(isinstance(base, ast.Name) and base.id == "Wording" for base in each.bases)
    }
    found = {}
    for name, tree in trees.items():
        known = dict(sentences[name])
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module in by_module:
                theirs = sentences[by_module[node.module]]
                known |= {each.name: theirs[each.name] for each in node.names if each.name in theirs}
        for line, words in _compared(tree, known, wordings):
            if not words.startswith(OF_OTHERS.get(name, ()) + OF_FILES.get(name, ())):
                found[f"{name}:{line}"] = words
    assert not found, "compare a code, or a value (docs/architecture.md)"


def _is_sentence(node: ast.AST | None) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and len(node.value.split()) > 1


def _constants(tree: ast.Module) -> Iterator[tuple[str, str]]:
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and _is_sentence(node.value):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                if isinstance(target, ast.Name):
                    yield target.id, str(node.value.value)  # type: ignore[union-attr]


def _compared(tree: ast.Module, known: dict[str, str], wordings: set[str]) -> Iterator[tuple[int, str]]:
    """Yield the sentences that are compared, or looked for in a text, each with its line."""
    for node in ast.walk(tree):
        operands: list[ast.expr] = []
        if isinstance(node, ast.Compare):
            operands = [node.left, *node.comparators]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in SEARCHES:
            operands = node.args
        elif isinstance(node, ast.MatchValue):
            operands = [node.value]
        for operand in operands:
            made = operand.func if isinstance(operand, ast.Call) else operand
            if _is_sentence(operand):
                yield operand.lineno, operand.value  # type: ignore[attr-defined]
            elif isinstance(operand, ast.Name) and operand.id in known:
                yield operand.lineno, known[operand.id]
            elif isinstance(made, ast.Attribute) and isinstance(made.value, ast.Name) and made.value.id in wordings:
                yield operand.lineno, f"{made.value.id}.{made.attr}"
