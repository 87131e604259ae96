"""A limit on the methods of a class, which no reason lifts."""

from __future__ import annotations

from tests.checks.class_bases import PARTS, ROOT, classes_in, is_special, lineage, methods_of

MOST = 40
MOST_WITH_BASES = 60
"""Bases only hide how much a class can do. Engines, whose interface alone has some 36, and widgets exceed 40."""
NARROW_ROOMS = (ROOT / "bridge" / "rsb_bridge" / "route", ROOT / "bridge" / "rsb_bridge" / "link")
"""Where the methods of all bases count as a class's own do."""


def test_class_has_few_methods() -> None:
    """Properties count; special methods, and bases from outside the project, do not."""
    seen, wide = 0, {}
    for path in (path for part in PARTS for path in (ROOT / part).rglob("*.py")):
        most_with_bases = MOST if any(path.is_relative_to(room) for room in NARROW_ROOMS) else MOST_WITH_BASES
        for node in classes_in(path):
            own, *bases = ({name for name in methods_of(each) if not is_special(name)} for each in lineage(path, node))
            seen += 1
            if len(own) > MOST or len(own.union(*bases)) > most_with_bases:
                wide[f"{path.relative_to(ROOT)}: {node.name}"] = len(own), len(own.union(*bases))
    assert seen > 1000
    assert not wide, "split it into parts: methods of its own, and with those of its bases"
