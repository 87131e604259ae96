"""A parser to be fuzzed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

from tests.fuzz.editing import edit_bytes

from rsb_bridge.model.text import is_clean

CORPUS = Path(__file__).with_name("corpus")
LONGEST = 4096
"""Bytes of an input."""


def check_text(text: str, longest: int) -> None:
    """A text that an operator is shown does nothing to a terminal, and is short."""
    assert is_clean(text)
    assert len(text) <= longest


@dataclass(frozen=True)
class Parser:
    """A parser, and the conditions that hold for all its inputs.

    Attributes:
        read: has it read an input. Raises where something is not as it should be: an exception that is not documented,
            output without a bound, or a value that does not come back equal from its own encoding.
        seeds: inputs of which all or nearly all is right.
        edit: makes another input of one, which keeps to the outer form.
        corpora: the folder whose folder of its name has inputs that were found once.
    """

    name: str
    read: Callable[[bytes], None]
    seeds: tuple[bytes, ...]
    edit: Callable[[bytes, Random], bytes] = edit_bytes
    corpora: Path = CORPUS

    @property
    def corpus(self) -> Path:
        return self.corpora / self.name

    def kept(self) -> Iterator[Path]:
        return (path for path in sorted(self.corpus.glob("*")) if path.is_file())
