"""The surfaces of the rooms for the simulated camera: walls, floors, ceilings and furniture, made once.

A texture is an array of rows of colours, 0xRRGGBB.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from rsb_bridge.ros.simulation.rooms import BOTTOM, FURNITURE, LEFT, RIGHT, ROOMS, TOP, WALLS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Colours: TypeAlias = "NDArray[np.uint32]"
    _Image: TypeAlias = "NDArray[np.floating[Any]]"
    _Colour: TypeAlias = "tuple[float, float, float]"

SIZE = 128
"""Rows and columns of a wall's texture, and of a piece of furniture's."""
WALL_WIDTH = 2.0
"""m of a wall after which its texture repeats."""
TEXELS = 40
"""Colours to a metre of floor and ceiling."""
FLOOR_WIDTH, FLOOR_DEPTH = round((RIGHT - LEFT) * TEXELS), round((TOP - BOTTOM) * TEXELS)
LAMPS = (
    (-5.2, 3.6), (0.0, 3.6), (5.2, 3.6), (-5.5, -3.6), (0.0, -3.6), (5.4, -3.6), (-5.2, 0.0), (0.0, 0.0), (5.2, 0.0),
)  # fmt: skip
_LAMP = 0.55
"""m of a lamp's side."""
_WALL_COLOURS = {
    "cream": (226, 214, 190),
    "sand": (222, 196, 150),
    "mint": (178, 212, 190),
    "blue": (160, 186, 214),
    "rose": (222, 178, 170),
    "grey": (190, 192, 190),
}
_WOOD, _DARK_WOOD, _WHITE, _STEEL = (158, 108, 66), (110, 72, 44), (236, 234, 228), (196, 200, 206)
_chance = np.random.default_rng(61)
_row, _column = np.mgrid[0:SIZE, 0:SIZE] / SIZE


def _plain(colour: _Colour, grain: float = 3.0) -> _Image:
    return np.array(colour, float) + _chance.normal(0, grain, (SIZE, SIZE, 1))


def _wall(colour: _Colour) -> _Image:
    """Return a painted wall with a darker lower part, a skirting board, and soft shadows above and below."""
    image = _plain(colour, 2.5)
    rows = np.linspace(2.5, 0, SIZE)[:, None, None]  # height in m
    image = np.where(rows < 0.95, image * 0.86, image)
    image = np.where((rows > 0.93) & (rows < 0.98), np.array(_WHITE) * 0.9, image)
    image = np.where(rows < 0.12, np.array((120, 98, 78)), image)
    lit: _Image = image * (1 - 0.25 * np.exp(-rows / 0.12) - 0.22 * np.exp(-(2.5 - rows) / 0.2))
    return lit


def _wood(colour: _Colour) -> _Image:
    grain = np.sin(40 * _row + 5 * np.sin(5 * _column) + 3 * np.sin(11 * _row)) * 0.06
    fine = _chance.normal(0, 0.03, (SIZE, 1)) + _chance.normal(0, 0.015, (SIZE, SIZE))
    wood: _Image = np.array(colour) * (1 + grain + fine)[:, :, None]
    return wood


def _framed(image: _Image, colour: _Colour, part: float = 0.06) -> _Image:
    edge = (_row < part) | (_row > 1 - part) | (_column < part) | (_column > 1 - part)
    return np.where(edge[:, :, None], np.array(colour, float), image)


def _panels(image: _Image, across: int, down: int, depth: float = 0.75) -> _Image:
    """Return an image with the grooves of so many panels."""
    row, column = _row * down % 1, _column * across % 1
    groove = (row < 0.03 * down) | (column < 0.03 * across)
    light = (row > 1 - 0.02 * down) | (column > 1 - 0.02 * across)
    return image * np.where(groove, depth, np.where(light, 1.12, 1.0))[:, :, None]


def _door(colour: _Colour) -> _Image:
    image = _plain(colour, 2)
    for top, bottom in ((0.08, 0.45), (0.53, 0.94)):
        inside = (_row > top) & (_row < bottom) & (_column > 0.15) & (_column < 0.85)
        deep = (_row > top + 0.025) & (_row < bottom - 0.025) & (_column > 0.2) & (_column < 0.8)
        image = np.where((inside & ~deep)[:, :, None], image * 0.72, image)
    knob = np.hypot((_row - 0.5) * 2.3, _column - 0.92) < 0.035
    return np.where(knob[:, :, None], np.array((214, 190, 110)), image)


def _books() -> _Image:
    image = _plain(_DARK_WOOD, 3)
    colours = np.array([(172, 60, 50), (52, 92, 140), (214, 178, 90), (70, 120, 84), (120, 70, 120), (224, 220, 204)])
    for shelf in range(5):
        top, bottom = 4 + shelf * 25, 25 + shelf * 25
        column = 4
        while column < SIZE - 10:
            wide, low = int(_chance.integers(3, 9)), int(_chance.integers(0, 7))
            book = colours[_chance.integers(len(colours))] * _chance.uniform(0.75, 1.05)
            image[top + low : bottom, column : column + wide] = book
            image[top + low : bottom, column] *= 0.6
            column += wide + int(_chance.integers(0, 2))
    return image


def _boxes() -> _Image:
    """Return a rack with boxes on it."""
    image = _plain((70, 74, 80), 3)
    for shelf in range(3):
        top, bottom = 6 + shelf * 42, 40 + shelf * 42
        column = 5
        while column < SIZE - 24:
            wide, low = int(_chance.integers(16, 32)), int(_chance.integers(0, 14))
            colour = np.array((186, 144, 96)) * _chance.uniform(0.75, 1.1)
            image[top + low : bottom, column : column + wide] = colour
            image[top + low : bottom, column + wide // 2] = colour * 1.2
            image[top + low : bottom, column] *= 0.7
            column += wide + 2
        image[bottom : bottom + 3] = (230, 120, 40)
    return image


def _window() -> _Image:
    """Return a bright sky over trees, with a frame."""
    sky = (1 - _row)[:, :, None] * np.array((120, 180, 245)) + _row[:, :, None] * np.array((228, 238, 250))
    clouds = np.clip(np.sin(9 * _column + 4 * _row) * np.sin(13 * _row + 2 * np.sin(6 * _column)), 0, 1)
    image = sky + 60 * clouds[:, :, None]
    hills = 0.66 + 0.07 * np.sin(7 * _column) + 0.03 * np.sin(23 * _column)
    trees = np.array((92, 132, 74)) * (0.9 + _chance.uniform(-0.15, 0.15, (SIZE, SIZE)))[:, :, None]
    image = np.where((_row > hills)[:, :, None], trees, image)
    bars = (np.abs(_column - 0.5) < 0.02) | (np.abs(_row - 0.35) < 0.015)
    return _framed(np.where(bars[:, :, None], np.array(_WHITE), image), _WHITE, 0.05)


def _painting(number: int) -> _Image:
    image = _plain((236, 228, 208), 2)
    match number:
        case 1:  # a sunset over the sea
            image = (1 - _row)[:, :, None] * np.array((52, 70, 140)) + _row[:, :, None] * np.array((250, 150, 70))
            image = np.where((np.hypot(_row - 0.55, _column - 0.6) < 0.12)[:, :, None], (255, 226, 120), image)
            image = np.where((_row > 0.62)[:, :, None], np.array((30, 60, 96)), image)
        case 2:  # mountains
            image = (1 - _row)[:, :, None] * np.array((130, 180, 220)) + _row[:, :, None] * np.array((240, 236, 220))
            for height, colour in ((0.35, (122, 140, 170)), (0.5, (84, 106, 120)), (0.68, (58, 84, 70))):
                ridge = height + 0.16 * np.abs(np.sin(5 * _column + 9 * height)) + 0.04 * np.sin(31 * _column)
                image = np.where((_row > ridge)[:, :, None], np.array(colour), image)
        case _:  # squares
            for at, colour in enumerate(((200, 50, 44), (240, 200, 60), (40, 80, 160), (30, 30, 34))):
                row, column = 0.14 + 0.4 * (at // 2), 0.14 + 0.4 * (at % 2)
                inside = (_row > row) & (_row < row + 0.32) & (_column > column) & (_column < column + 0.32)
                image = np.where(inside[:, :, None], np.array(colour), image)
    return _framed(image, (60, 44, 32), 0.05)


def _screen() -> _Image:
    image = _plain((24, 30, 44), 1) + (1 - _row)[:, :, None] * np.array((20, 40, 70))
    curve = np.abs(_row - 0.5 - 0.2 * np.sin(12 * _column)) < 0.03
    image = np.where(curve[:, :, None], (90, 230, 160), image)
    return _framed(image, (16, 16, 18), 0.05)


def _leaves() -> _Image:
    """Return leaves, with holes (0) between them."""
    image = np.zeros((SIZE, SIZE, 3))
    for _ in range(260):
        row, column, turn = *_chance.uniform(0.05, 0.95, 2), _chance.uniform(0, np.pi)
        if abs(column - 0.5) > 0.18 + 0.5 * np.sin(np.pi * (0.15 + 0.7 * row)) - 0.25:
            continue
        along = (_row - row) * np.cos(turn) + (_column - column) * np.sin(turn)
        across = (_column - column) * np.cos(turn) - (_row - row) * np.sin(turn)
        leaf = (along / 0.1) ** 2 + (across / 0.035) ** 2 < 1
        image[leaf] = np.array((52, 128, 58)) * _chance.uniform(0.6, 1.35)
    return image


def _stripes(first: _Colour, second: _Colour) -> _Image:
    return np.where((((_row * 6 + _column * 2) % 1) < 0.5)[:, :, None], np.array(first, float), np.array(second, float))


def _tools() -> _Image:
    image = _plain((150, 128, 96), 3)
    image = np.where((((_row * 16) % 1 < 0.2) & ((_column * 24) % 1 < 0.2))[:, :, None], image * 0.6, image)
    for at in range(9):
        column, length = 0.06 + at * 0.1, 0.3 + 0.35 * (at * 7 % 5) / 5
        handle = (np.abs(_column - column - 0.02) < 0.012) & (_row > 0.15) & (_row < 0.15 + length)
        head = (np.abs(_column - column - 0.02) < 0.032) & (_row > 0.12) & (_row < 0.2)
        colour = ((200, 60, 50), (60, 90, 160), (220, 180, 60))[at % 3]
        image = np.where(handle[:, :, None], np.array(colour), image)
        image = np.where(head[:, :, None], np.array((70, 74, 80)), image)
    return image


def _crate(colour: _Colour) -> _Image:
    red, green, blue = colour
    return _framed(_panels(_plain(colour, 3), 1, 4, 0.7), (0.7 * red, 0.7 * green, 0.7 * blue), 0.07)


def _sofa(colour: _Colour) -> _Image:
    soft = 1 + 0.12 * np.sin(np.pi * (_column * 3 % 1)) - 0.3 * (np.abs(_column * 3 % 1 - 0.5) > 0.48)
    sofa: _Image = _plain(colour, 4) * soft[:, :, None]
    return sofa


_LOOKS: dict[str, Callable[[], _Image]] = {
    "wall": lambda: _plain(_WALL_COLOURS["cream"]),
    "lintel": lambda: _plain(_WHITE, 1),
    "frame": lambda: _plain(_WHITE, 1),
    "red door": lambda: _door((178, 58, 48)),
    "green door": lambda: _door((64, 128, 84)),
    "blue door": lambda: _door((58, 96, 158)),
    "yellow door": lambda: _door((220, 178, 72)),
    "orange door": lambda: _door((214, 122, 52)),
    "white door": lambda: _door((226, 226, 220)),
    "wood": lambda: _framed(_wood(_WOOD), _DARK_WOOD, 0.05),
    "wardrobe": lambda: _panels(_wood(_WOOD), 3, 1),
    "workbench": lambda: _panels(_wood((128, 96, 64)), 4, 2),
    "cupboards": lambda: _panels(_plain((240, 236, 224), 2), 4, 1),
    "fridge": lambda: _panels(_plain(_STEEL, 2), 1, 2),
    "books": _books,
    "rack": _boxes,
    "window": _window,
    "painting 1": lambda: _painting(1),
    "painting 2": lambda: _painting(2),
    "painting 3": lambda: _painting(3),
    "screen": _screen,
    "leaves": _leaves,
    "pot": lambda: _plain((186, 98, 62), 4),
    "sofa": lambda: _sofa((66, 110, 128)),
    "sofa back": lambda: _sofa((58, 98, 116)),
    "stool": lambda: _plain((220, 132, 56), 3),
    "chair": lambda: _plain((56, 76, 130), 3),
    "bed": lambda: np.where((_row < 0.55)[:, :, None], _plain((92, 116, 164), 4), _wood(_DARK_WOOD)),
    "pillow": lambda: _plain(_WHITE, 2),
    "tools": _tools,
    "blue crate": lambda: _crate((62, 108, 172)),
    "orange crate": lambda: _crate((226, 126, 48)),
    "pillar": lambda: _stripes((228, 188, 44), (44, 44, 46)),
    "dock": lambda: np.where(
        (np.abs(_row - 0.4) < 0.12)[:, :, None], np.array((96, 240, 130)), _plain((52, 56, 60), 2)
    ),
    "goal": lambda: _stripes((206, 46, 40), _WHITE),  # a surveyor's pole
}
TOPS: dict[str, _Colour] = {
    "wood": (170, 120, 76), "workbench": (150, 116, 80), "cupboards": (92, 88, 86), "sofa": (78, 124, 142),
    "sofa back": (66, 108, 126), "stool": (232, 150, 74), "chair": (66, 88, 146), "bed": (108, 134, 184),
    "pillow": (242, 240, 236), "blue crate": (78, 124, 190), "orange crate": (238, 146, 66), "dock": (66, 72, 76),
    "pot": (84, 60, 44), "goal": (206, 46, 40),
}  # fmt: skip
"""Colours of what is seen from above, or _DARK_WOOD."""


def top_colour(look: str) -> int:
    """Return the colour of the upper or lower side of a piece of furniture."""
    return int(_packed(np.array(TOPS.get(look, _WHITE if look == "lintel" else _DARK_WOOD)).reshape(1, 1, 3))[0, 0])


@cache
def furniture(look: str) -> Colours:
    """Return the texture of a side of a piece of furniture."""
    return _packed(_LOOKS[look]())


@cache
def surfaces() -> tuple[Colours, dict[str, int], int, int]:
    """Return all colours of walls, floor and ceiling, and where each room's wall, the floor and the ceiling begin."""
    walls = [_packed(_wall(colour)) for colour in _WALL_COLOURS.values()]
    places = {name: at * SIZE * SIZE for at, name in enumerate(_WALL_COLOURS)}
    floor = len(walls) * SIZE * SIZE
    ceiling = floor + FLOOR_WIDTH * FLOOR_DEPTH
    return np.concatenate([each.ravel() for each in (*walls, _floor(), _ceiling())]), places, floor, ceiling


def _plane() -> tuple[_Image, _Image]:
    """Return x and y of each colour of the floor."""
    x = LEFT + (np.arange(FLOOR_WIDTH) + 0.5) / TEXELS
    y = BOTTOM + (np.arange(FLOOR_DEPTH) + 0.5) / TEXELS
    across, along = np.meshgrid(x, y)
    return across, along


def _floor() -> Colours:
    x, y = _plane()
    image = np.full((*x.shape, 3), 150.0)
    for room in ROOMS:
        inside = (x >= room.left) & (x < room.right) & (y >= room.bottom) & (y < room.top)
        image[inside] = _FLOORS[room.floor](x, y)[inside]
    for left, bottom, right, top, colour in (
        (-7.4, 2.2, -4.2, 4.4, (150, 62, 58)),
        (-5.5, -5.2, -4.0, -3.2, (88, 110, 150)),
        (-1.4, -0.5, 1.4, 0.5, (112, 84, 120)),
    ):
        inside = (x > left) & (x < right) & (y > bottom) & (y < top)
        border = inside & ((x < left + 0.12) | (x > right - 0.12) | (y < bottom + 0.12) | (y > top - 0.12))
        weave = 1 + 0.08 * np.sin(60 * x) * np.sin(60 * y)
        image = np.where(inside[:, :, None], np.array(colour) * weave[:, :, None], image)
        image = np.where(border[:, :, None], np.array((226, 206, 160)), image)
    stripe = (np.abs(np.abs(x - 6.25) - 0.5) < 0.05) & (y < -4.6)
    image = np.where(stripe[:, :, None], np.array((230, 190, 50)), image)
    return _packed(image * (_lamp_light(x, y) * _shadow(x, y, 0.3, 0.18) + _sunlight(x, y))[:, :, None])


def _planks(x: _Image, y: _Image) -> _Image:
    row = np.floor(y / 0.16)
    plank = np.floor(x / 1.1 + row * 0.37)
    tone = 1 + 0.14 * np.sin(row * 12.9898 + plank * 78.233) + 0.03 * np.sin(90 * y + 4 * np.sin(3 * x))
    gap = (y / 0.16 % 1 < 0.09) | ((x / 1.1 + row * 0.37) % 1 < 0.012)
    colour: _Image = np.array((176, 124, 78)) * np.where(gap, 0.6, tone)[:, :, None]
    return colour


def _tiles(x: _Image, y: _Image, size: float, first: _Colour, second: _Colour) -> _Image:
    odd = (np.floor(x / size) + np.floor(y / size)) % 2 > 0
    joint = (x / size % 1 < 0.05) | (y / size % 1 < 0.05)
    image = np.where(odd[:, :, None], np.array(first, float), np.array(second, float))
    colour: _Image = np.where(joint[:, :, None], image * 0.75, image) + _chance.normal(0, 3, (*x.shape, 1))
    return colour


_FLOORS: dict[str, Callable[[_Image, _Image], _Image]] = {
    "planks": _planks,
    "tiles": lambda x, y: _tiles(x, y, 0.5, (232, 230, 222), (120, 140, 136)),
    "stone": lambda x, y: _tiles(x, y, 0.8, (196, 184, 164), (180, 166, 146)),
    "carpet": lambda x, y: np.array((96, 112, 138)) + _chance.normal(0, 7, (*x.shape, 1)),
    "concrete": lambda x, y: _tiles(x, y, 2.0, (148, 148, 144), (140, 140, 138)),
}


def _ceiling() -> Colours:
    x, y = _plane()
    image = np.array((232, 230, 224)) + np.zeros((*x.shape, 1))
    light = (0.7 + 0.3 * _lamp_light(x, y)) * _shadow(x, y, 0.3, 0.25, of_walls=True)
    image = image * light[:, :, None]
    for lamp_x, lamp_y in LAMPS:
        far = np.maximum(np.abs(x - lamp_x), np.abs(y - lamp_y))
        image = np.where((far < _LAMP / 2)[:, :, None], np.array((255, 252, 240)), image)
        image = np.where(((far >= _LAMP / 2) & (far < _LAMP / 2 + 0.04))[:, :, None], np.array((150, 150, 150)), image)
    return _packed(image)


def _lamp_light(x: _Image, y: _Image) -> _Image:
    brightest = np.zeros_like(x)
    for lamp_x, lamp_y in LAMPS:
        brightest = np.maximum(brightest, np.exp(-((x - lamp_x) ** 2 + (y - lamp_y) ** 2) / 7))
    return 0.76 + 0.36 * brightest


def _shadow(x: _Image, y: _Image, strength: float, width: float, *, of_walls: bool = False) -> _Image:
    """Return how much light is left beside walls and furniture."""
    nearest = np.full(x.shape, 9.0)
    reach = round(4 * width * TEXELS)
    for box in WALLS if of_walls else (*WALLS, *FURNITURE):
        if box.low > 0.1:
            continue
        left, right = (round((each - LEFT) * TEXELS) for each in (box.left, box.right))
        bottom, top = (round((each - BOTTOM) * TEXELS) for each in (box.bottom, box.top))
        part = slice(max(0, bottom - reach), max(0, top + reach)), slice(max(0, left - reach), max(0, right + reach))
        across = np.maximum(np.maximum(box.left - x[part], x[part] - box.right), 0)
        along = np.maximum(np.maximum(box.bottom - y[part], y[part] - box.top), 0)
        nearest[part] = np.minimum(nearest[part], np.hypot(across, along))
    light: _Image = 1 - strength * np.exp(-nearest / width)
    return light


def _sunlight(x: _Image, y: _Image) -> _Image:
    """Return the light of the windows in the north on the floor, in slanted panes."""
    light = np.zeros_like(x)
    for box in FURNITURE:
        if box.look == "window" and box.top == TOP:
            behind = TOP - y
            middle = (box.left + box.right) / 2 - 0.35 * behind
            across = x - middle
            width = (box.right - box.left) / 2
            pane = (np.abs(across) < width - 0.05) & (np.abs(across) > 0.04) & (behind > 0.9) & (behind < 2.3)
            light = np.maximum(light, np.where(pane, 0.38, 0))
    return light


def _packed(image: _Image) -> Colours:
    red, green, blue = np.moveaxis(image.clip(0, 255).astype(np.uint32), 2, 0)
    packed: Colours = red << 16 | green << 8 | blue
    return packed
