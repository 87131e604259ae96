"""How images are drawn on this terminal: as pixels or in characters, in how many colours, and how finely."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_bridge.feature_api import Wording
from rsb_extras.pictures.blocks import image_rows, wished_pixels
from rsb_extras.pictures.cell_image import fine_for, image_of, is_drawn, styles_in
from rsb_extras.pictures.graphics import USUAL_CELL, frame_of, protocol_of
from rsb_extras.pictures.picture import Cells, Pixels, sized
from rsb_extras.pictures.picture_pane import IMAGE_WITHIN
from rsb_extras.pictures.picture_rows import UnreadableError, has_pillow, rgb_of

if TYPE_CHECKING:
    from rsb_extras.pictures.cell_image import Marked
    from rsb_extras.pictures.picture import Series, Wish
    from rsb_extras.pictures.picture_pane import PicturePane
    from rsb_extras.pictures.picture_rows import Row

_SLOW, _IN_CHARACTERS = 0.3, 3
"""s that a line may take for an image, in which keys wait; and how often its resolution is halved until it is drawn in
characters, which come in pieces between other things."""
_PIXELS = 4
"""Times as many pixels of an image with one strain less."""
_MOST_TIMES = 16
"""Times as many of its bytes, at most: with true colours instead of few. More was another scene."""
_DEAR = 50_000
"""Bytes/s of a line below which 256 colours are worth more than true ones: an image in blocks comes twice as fast."""


class _Finer(NamedTuple):
    """An image with one strain less.

    Attributes:
        times: how many times the bytes it takes.
        is_sent: whether one was sent, so that the line's rate is known.
    """

    times: float
    is_sent: bool


class StyleText(Wording):
    NO_PILLOW = "the picture cannot be drawn: a map in pixels needs Pillow here: pip install 'rsb-console[look]'"
    ASCII = "ASCII: LC_ALL=C.UTF-8 shows more, if the terminal has Unicode"
    FEW_COLOURS = "{colours} colours: COLORTERM=truecolor or terminal: {{colours: true}} in console.yaml shows more"


class ImageStyle:
    """The style of the images of one pane.

    Attributes:
        strain: how often the resolution is halved for a terminal that reads slowly.
    """

    def __init__(self, pane: PicturePane) -> None:
        self._pane = pane
        self.strain = 0
        self._left: tuple[int, bool] | None = None
        """Bytes of the image that has just been found too large, and whether it was sent."""
        self._finer: dict[int, _Finer] = {}
        """What is known of the images with one strain less, by strain."""

    @property
    def colours(self) -> int:
        app, terminal = self._pane.app, self._pane.terminal
        facts = terminal.facts
        if app.no_color or app.console.color_system is None:
            return 0
        # With more, a map has half blocks of two tints, in which ASCII would show walls.
        if app.ansi_color or terminal.ascii_only:
            return min(facts.colours, 16)
        return min(facts.colours, 256) if terminal.writer.line.rate < _DEAR else facts.colours

    @property
    def _image_colours(self) -> int:
        """The colours for an image: in ASCII, which has no shapes for two of them, characters show its brightness."""
        return 0 if self._pane.terminal.ascii_only else self.colours

    @property
    def shows_pixels(self) -> bool:
        terminal = self._pane.terminal
        return not terminal.ascii_only and protocol_of(terminal.facts) != "" and self.strain < _IN_CHARACTERS

    @property
    def is_measured(self) -> bool:
        """Whether images in characters are measured as pixels. Sixels are as large at any strain, and slow to make."""
        return self.strain > 0 and protocol_of(self._pane.terminal.facts) == "kitty"

    @property
    def _cell(self) -> tuple[float, float]:
        """Pixels of a character, as far as the line takes them."""
        across, down = self._pane.terminal.facts.cell or USUAL_CELL
        return across / 2**self.strain, down / 2**self.strain

    def fitted(self, wish: Wish) -> Wish:
        """Return a wish for the pane's present size, as fine as the terminal shows it."""
        size, facts = self._pane.size, self._pane.terminal.facts
        if self.shows_pixels and facts.cell is not None:
            across, down = map(round, self._cell)
        else:
            across, down = wished_pixels(self._image_colours, sextants=facts.draws_sextants)
        wish = sized(wish, size.width, size.height, across, down, facts.shape)
        return msgspec.structs.replace(wish, fine=fine_for(self._cell) if self.shows_pixels else 1)

    def is_image(self, content: object) -> bool:
        """Whether a picture is shown as an image, in pixels or in blocks."""
        return isinstance(content, Pixels) or (is_drawn(content) and (self.shows_pixels or isinstance(content, Cells)))

    async def image(
        self, content: Cells | Pixels | Series, wish: Wish, *, cursor: int | None, mark: Marked | None
    ) -> Pixels:
        """Return a picture as an image; one of a map or a plot has an operator's sign or the cursor on it.

        Raises:
            UnreadableError: the other side's image is damaged, or it has sent a map for pixels unasked, and Pillow is
                missing.
        """
        if isinstance(content, Pixels):
            return await asyncio.to_thread(_coarsened, content, wish) if self.strain else content
        if not has_pillow():
            raise UnreadableError(StyleText.NO_PILLOW())
        inks, size = self._pane.inks(styles_in(content), self._cell), (wish.width, wish.height)
        return await asyncio.to_thread(image_of, content, size, wish.shape, inks, cursor=cursor, mark=mark)

    def in_blocks(self, content: Pixels, wish: Wish) -> list[Row]:
        sextants = self._pane.terminal.facts.draws_sextants
        return image_rows(content, wish, colours=self._image_colours, sextants=sextants)

    def spare(self) -> bool:
        """Draw fewer pixels, and at last characters, for a line that takes long for an image; or more again.

        Return whether that changes the style.
        """
        pane, before, rate = self._pane, self.strain, self._pane.terminal.writer.line.rate
        if self._left is not None:
            size, is_sent = self._left
            self._left, self._finer[before] = None, _Finer(min(_MOST_TIMES, size / max(1, pane.whole_bytes)), is_sent)
        if self.shows_pixels and pane.image_bytes / rate > _SLOW:
            self.strain += 1
            self._left = pane.whole_bytes, not pane.is_left_out
        elif before and (_PIXELS if self.shows_pixels else 1) * pane.image_bytes / rate < _SLOW / 2:
            self.strain -= self._takes_finer(pane.whole_bytes / rate)
        return self.strain != before

    def _takes_finer(self, seconds: float) -> bool:
        """Whether the line is to get a finer image than the one that takes it so long: it lacks all of that one.

        A still scene takes nothing, and would be sent finer and coarser by turns. But only an image that was sent has
        told how fast the line is: one that was left out is tried as soon as it may be sent.
        """
        times, is_sent = self._finer[self.strain]
        return times * seconds < (_SLOW / 2 if is_sent else IMAGE_WITHIN / 2)

    def line(self) -> str:
        """Return what the terminal was found to show, or how to get more."""
        terminal = self._pane.terminal
        if terminal.ascii_only:
            return StyleText.ASCII()
        few = terminal.facts.colours <= 16 and not self._pane.app.no_color
        return StyleText.FEW_COLOURS(colours=terminal.facts.colours or "no") if few else terminal.facts.line()


def _coarsened(image: Pixels, wish: Wish) -> Pixels:
    """Return an image that was made for a finer wish with as few pixels as this one asks for; on a thread.

    Raises:
        UnreadableError: the other side's image is damaged.
    """
    factor = round(image.width / (frame_of(image, wish).width * wish.across))
    if factor < 2:
        return image
    from PIL import Image  # noqa: PLC0415 -- optional

    few = Image.frombytes("RGB", (image.width, image.height), rgb_of(image)).reduce(factor)
    # The last pixels may stand for less than the others.
    shape = image.shape * (image.height / few.height) / (image.width / few.width)
    return Pixels(few.width, few.height, few.tobytes(), shape=shape)
