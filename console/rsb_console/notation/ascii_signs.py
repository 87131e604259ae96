"""ASCII in place of the console's signs, for terminals without Unicode. It needs neither Textual nor Rich."""

from __future__ import annotations

# Dots of a braille cell (Unicode block 2800), column by column from the bottom up.
DOTS = ((0x40, 0x04, 0x02, 0x01), (0x80, 0x20, 0x10, 0x08))


def _ascii_braille(dots: int) -> str:
    """Return an ASCII character about as high in its cell as the dots of a braille cell."""
    if not dots:
        return " "
    heights = [y for column in DOTS for y, dot in enumerate(column) if dots & dot]
    if max(heights) - min(heights) >= 2:
        return "|"
    return "_.-'"[round(sum(heights) / len(heights))]


_LOOKALIKES = {
    "o": "●◐○⭘", "?": "◌", "!": "▲", "=": "‖═▅⇄", "x": "✗×", "v": "✓✔↓▼▾", ".": "·▃▖▗", ">": "→▸▶⇧", "<": "←◀",
    "^": "↑⌃⎋", "_": "▁▂␣", "-": "▄─━–—▔▀", "+": "▆┌┐└┘├┤┬┴┼╭╮╯╰", "*": "▇•◆◉", "#": "█■□▙▛▜▟", "%": "◇", "~": "…⏎≈",
    "|": "│┃║▌▐▕▎▏▊▋▍▉", "/": "⊘▞", "\\": "⊖▚", "@": "◔", "u": "µ", "'": "’▘▝", '"': "“”",
}  # fmt: skip
ASCII: dict[int, str] = {ord(char): sign for sign, chars in _LOOKALIKES.items() for char in chars}
ASCII |= {0x2800 + dots: _ascii_braille(dots) for dots in range(256)}
