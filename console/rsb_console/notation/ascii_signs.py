"""ASCII in place of the console's signs: for which terminals, and which. Commands need it before they need Textual."""

from __future__ import annotations

import unicodedata

TYPE_CHECKING = False  # without typing, which takes a while
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_WITHOUT_SIGNS = ("linux", *(f"vt{digit}" for digit in range(1, 10)))
"""The beginnings of TERM of terminals whose fonts lack most signs; ``vte`` is another family, with Unicode.

Of the 456 fonts for the Linux console in Debian's console-setup 1.221, none has braille, eighths of a block, quadrants
or ``◌◇◔``. 139 have half blocks; the usual ones of Debian and Ubuntu (Lat15, Uni2) do not.
"""

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
    "o": "●◐○⭘", "!": "▲", "=": "‖═▅⇄", "x": "✗×╳", "v": "✓✔↓▼▾", ".": "·▃▖▗░", ">": "→▸▶⇧", "<": "←◀≤",
    "^": "↑⌃⎋", "_": "▁▂␣", "-": "▄─━–—▔▀╌╍┄┅┈┉╴╶╸╺╼╾", "+": "▆±", "*": "▇•◆◉▪", "#": "█■□▙▛▜▟", "%": "◇▓", "~": "…⏎≈",
    "|": "│┃║▌▐▕▎▏▊▋▍▉╎╏┆┇┊┋╵╷╹╻╽╿", "/": "⊘▞↗↙╱", "\\": "⊖▚↖↘╲", "@": "◔", "u": "µ", "'": "’▘▝", '"': "“”", ":": "▒◌",
    "d": "°", "2": "²", "0": "◎", " ": "\u00a0",
}  # fmt: skip
_LETTERS = {
    "A": "Æ", "D": "ĐÐ", "H": "Ħ", "L": "Ł", "O": "ØŒ", "S": "ẞ", "T": "ÞŦ", "a": "æ", "d": "đð", "h": "ħ", "i": "ı",
    "l": "ł", "o": "øœ", "s": "ß", "t": "þŧ",
}  # fmt: skip
"""Latin letters that Unicode does not take apart into one of ASCII and its marks."""
ASCII: dict[int, str] = dict.fromkeys(range(0x2500, 0x2580), "+")  # the corners and crossings of frames
ASCII |= {ord(char): sign for signs in (_LOOKALIKES, _LETTERS) for sign, chars in signs.items() for char in chars}
ASCII |= {0x2800 + dots: _ascii_braille(dots) for dots in range(256)}


def to_ascii(text: str, cells: Callable[[str], int] = len) -> str:
    """Replace every character that is not ASCII by ASCII of the same width: signs, and Latin letters by their base.

    Args:
        cells: gives the width of a character; without it, each takes one cell.
    """
    # Most texts are, and this runs for each piece that is drawn.
    if text.isascii():
        return text
    # One cell has no room for +-, so it takes a blank's, too.
    plain = text.replace(" ± ", " +-").translate(ASCII)
    return plain if plain.isascii() else "".join(_ascii_of(char) or "?" * cells(char) for char in plain)


def _ascii_of(char: str) -> str:
    """Return a character of ASCII, the base of a letter, or an empty string."""
    base = unicodedata.normalize("NFD", char)[0]
    # Letters only: the base of "not equal" would be "equal".
    return char if char.isascii() else base if base.isascii() and base.isalpha() else ""


def prefers_ascii(environ: Mapping[str, str]) -> bool:
    """Whether to draw in ASCII, by the rules of docs/console-settings.md.

    Args:
        environ: the environment. Where it sets no locale or LANG=C, Python has added LC_CTYPE=C.UTF-8 (PEP 538).
    """
    if chosen := environ.get("LC_ALL"):  # no system sets it: the user knows better than TERM
        return not _is_utf8(chosen)
    added, language = environ.get("LC_CTYPE") == "C.UTF-8", environ.get("LANG")
    character_set = language if added and language in ("C", "POSIX") else environ.get("LC_CTYPE") or language
    term = environ.get("TERM", "").removeprefix("screen.")  # GNU screen on another terminal
    return not _is_utf8(character_set or "C.UTF-8") or term.startswith(_WITHOUT_SIGNS)


def _is_utf8(locale: str) -> bool:
    return "utf" in locale.lower()
