"""What an operator writes into the fields of a message."""

from __future__ import annotations

from typing import TypeAlias

FIELDS_LENGTH = 32 << 10
"""Bytes of the text that they are written in."""

Fields: TypeAlias = str | list["Fields"] | dict[str, "Fields"] | None
"""As it stands in YAML. Whether ``1.10`` is a number or a text, the field's type says. None: nothing is written."""


class FieldError(ValueError):
    """Something does not fit into its field; the text names the field, and says what it takes."""
