"""The inside of rich's styles and of its console."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.color import ColorSystem

if TYPE_CHECKING:
    from rich.console import Console
    from rich.style import Style


def attributes_of(style: Style) -> int:
    """Return a style's attributes as bits, from bold at 1: by their names, each of many cells takes 13 look-ups."""
    return style._attributes & style._set_attributes


def colours_of(console: Console) -> ColorSystem:
    """Return the colours that a console writes: in public, it has only their name."""
    return console._color_system or ColorSystem.TRUECOLOR


def use_colours(console: Console, colours: ColorSystem) -> None:
    """Have a console write other colours: rich finds them out by TERM, and once."""
    console._color_system = colours
