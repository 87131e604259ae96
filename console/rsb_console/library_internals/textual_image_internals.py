"""The encoder of textual-image. Its public modules ask the terminal when they are imported."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.Image import Image


def sixels_of(image: Image) -> str:
    """Return an image as sixels."""
    from textual_image._sixel import image_to_sixels  # noqa: PLC0415 (an extra)

    return image_to_sixels(image)
