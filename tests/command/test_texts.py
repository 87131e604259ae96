"""All texts that operators may read, as `make texts` writes them."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
from tests.support.wording import says

from rsb_bridge.model.wording import Wording

_DOCS = Path(__file__).parents[2] / "docs"


def test_texts_have_several_words_and_no_docstrings() -> None:
    found = runpy.run_path(str(_DOCS / "texts.py"))["page"]().splitlines()
    assert "# bridge/rsb_bridge/wire/protocol_error.py" in found
    assert not any(line.startswith("Attributes:") for line in found)


class Sample(Wording):
    LONG = "{name!r} has {length:,} bytes; at most {limit}"
    PLAIN = "100% of (all)"


def test_code_is_found_by_words_without_parameters() -> None:
    text = Sample.LONG(name="a", length=4096, limit=8)
    assert text == "'a' has 4,096 bytes; at most 8"
    assert says(f"error:\n  {text}.", Sample.LONG)
    assert says(text, Sample.LONG, length=4096)
    assert not says(text, Sample.LONG, length=4097)
    assert not says(text, Sample.PLAIN)
    assert says(Sample.PLAIN(), Sample.PLAIN)
    with pytest.raises(TypeError):
        says(text, Sample.LONG, width=1)
