"""Answers of both sides of links in the shell: their table, and the side that has a given name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_console.command.shell import print_error
from rsb_console.command.target import UsageError
from rsb_console.notation.side_answer import SideText, side_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from rsb_bridge.model.wording import Wording
    from rsb_console.notation.side_answer import SideAnswer


def table_lines(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table whose columns are as wide as their widest cells."""
    table = [headings, *rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for cells in table:
        yield "  ".join(f"{cell:<{width}}" for cell, width in zip(cells, widths, strict=True)).rstrip()


def problems_of(sides: Iterable[SideAnswer], link: str = "") -> dict[str, str]:
    """Return the reasons why some sides gave no answer, by their links.

    Raises:
        EngineError: the only link that was asked for gave none.
    """
    problems = {side.link: side.problem for side in sides if side.problem}
    if link and link in problems:
        raise EngineError(SideText.of(link, problems[link]))
    return problems


def print_problems(role: str, problems: Mapping[str, str]) -> None:
    """Print what `problems_of` has returned, for people."""
    for link, problem in problems.items():
        print_error(SideText.of(side_of(role, link), problem))


def chosen_side(
    name: str, listed: Iterable[tuple[str, str]], sides: Iterable[SideAnswer], *, several: Wording, unknown: Wording
) -> str:
    """Return the link whose other side has what is named, or an empty string for this side.

    Args:
        listed: links and names of all that there is.
        sides: the sides that were asked.
        several: says that `count` sides have a `name`; choose one of `options`.
        unknown: says that there is no `name`, with the sides' `problems`, and what is `known`.

    Raises:
        UsageError: no side has it, or several.
    """
    every = [*listed]
    found = [link for link, each in every if each == name]
    if len(found) > 1:
        options = "; ".join(f"--link {link}" if link else "--here" for link in found)
        raise UsageError(several(count=len(found), name=name, options=options))
    if not found:
        known = ", ".join(sorted({each for _, each in every})) or "none"
        problems = "".join(f" ({side.link}: {side.problem})" for side in sides if side.problem)
        raise UsageError(unknown(name=name, problems=problems, known=known))
    return found[0]
