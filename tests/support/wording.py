"""Recognizes the program's texts, so that tests do not quote them."""

from __future__ import annotations

import re
from string import Formatter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.model.wording import Wording


def says(text: object, wording: Wording, **parameters: object) -> bool:
    """Whether a text contains what a table has under a code, with the given parameters and any others.

    White space counts as one space, since terminals wrap lines.
    """
    return re.search(pattern(wording, **parameters), " ".join(str(text).split())) is not None


def has_text(text: object, about: str | Wording, **parameters: object) -> bool:
    """Whether a text has these words in it, or what a table has under a code."""
    return says(text, about, **parameters) if not isinstance(about, str) else about in str(text)


def pattern(wording: Wording, **parameters: object) -> str:
    """Return a regular expression, for `pytest.raises(match=...)`."""
    parts = []
    for literal, field, spec, conversion in Formatter().parse(" ".join(wording.value.split())):
        parts.append(re.escape(literal))
        if field is None:
            continue
        name = re.split(r"[.\[]", field)[0]
        if name in parameters:
            filled = f"{{{field}{f'!{conversion}' if conversion else ''}{f':{spec}' if spec else ''}}}"
            parts.append(re.escape(re.sub(r"\s+", " ", filled.format(**parameters))))
        else:
            parts[-1] = re.sub(r"\\ $", r"\\ ?", parts[-1])  # an empty parameter leaves one space of two
            parts.append(".*")
    if unknown := parameters.keys() - {
        re.split(r"[.\[]", field)[0] for _, field, _, _ in Formatter().parse(wording.value) if field
    }:
        raise TypeError(f"{wording} has no {', '.join(unknown)}")
    return "".join(parts)
