"""The effect of a command, or of a Yes, on robots and files: from it follows what must not come late."""

import enum


class Effect(enum.Flag):
    """The effect of what an operator agrees to."""

    HARMLESS = 0
    """It stops something, or changes what can be changed back."""
    MOVES = enum.auto()
    """A robot may move, or messages may cross that do not cross now."""
    LOSES = enum.auto()
    """Something ends, is removed or is overwritten."""
