"""Maps and plots as images: what the characters show is there, finer."""

from __future__ import annotations

import math

import msgspec
import pytest

pytest.importorskip("PIL")

from rsb_extras.pictures.cell_image import Inks, Marked, fine_for, image_of, is_drawn, styles_in
from rsb_extras.pictures.drawing import Canvas
from rsb_extras.pictures.paper import Paper
from rsb_extras.pictures.picture import MOST_COLUMNS, MOST_ROWS, Cells, Curve, Pixels, Series, Wish
from rsb_extras.pictures.picture_rows import AXIS
from rsb_extras.pictures.tests.map_view_helpers import grid, path, picture, pose
from rsb_extras.pictures.tests.samples import cells_of

PAPER = Paper.of("#101010", "#d0d0d0")
INKS = {"path": (0, 0, 255), "robot": (0, 255, 0), "goal": (255, 255, 0), "curve": (255, 0, 255)}
CELL = 10.0, 20.0


def drawn(
    content: Cells | Series, size: tuple[int, int] = (80, 24), *, cursor: int | None = None, mark: Marked | None = None
) -> Pixels:
    inks = Inks(PAPER, {style: INKS.get(style, (200, 200, 200)) for style in styles_in(content)}, CELL)
    return image_of(content, size, 2.0, inks, cursor=cursor, mark=mark)


def colours(image: Pixels) -> dict[tuple[int, ...], set[tuple[float, float]]]:
    """Return the places of each colour, in parts of the image's width and height."""
    places: dict[tuple[int, ...], set[tuple[float, float]]] = {}
    for at in range(0, len(image.data), 3):
        y, x = divmod(at // 3, image.width)
        places.setdefault(tuple(image.data[at : at + 3]), set()).add((x / image.width, y / image.height))
    return places


def middle(places: set[tuple[float, float]]) -> tuple[float, float]:
    across, down = zip(*places, strict=True)
    return sum(across) / len(places), sum(down) / len(places)


@pytest.mark.parametrize(("cell", "fine"), [((5.0, 10.0), 1), ((8.0, 16.0), 2), ((10.0, 20.0), 3), ((30.0, 60.0), 4)])
def test_larger_characters_have_finer_maps(cell: tuple[float, float], fine: int) -> None:
    assert fine_for(cell) == fine


@pytest.mark.parametrize("fine", [2, 3, 4])
def test_map_has_same_places_in_characters_and_pixels(fine: int) -> None:
    messages = grid(), path([(-4.0, -4.0), (4.0, 4.0)]), pose(2.0, -2.0, 0.0)
    wish = Wish(width=60, height=20)
    coarse = cells_of(picture(*messages, wish=wish))
    fine_cells = cells_of(picture(*messages, wish=msgspec.structs.replace(wish, fine=fine)))
    assert (len(fine_cells.rows), fine_cells.fine) == (20 * fine, fine)
    assert is_drawn(fine_cells)
    assert not is_drawn(coarse)
    assert coarse.scale is not None
    assert fine_cells.scale is not None
    assert fine_cells.scale.column * fine == pytest.approx(coarse.scale.column, rel=0.05)
    image = drawn(fine_cells)
    assert image.height * image.shape / image.width == pytest.approx(2.0 * 20 / 60)
    above_legend = {colour: {each for each in at if each[1] < 19 / 20} for colour, at in colours(image).items()}
    x, y = middle(above_legend[INKS["goal"]])
    scale = coarse.scale
    assert (scale.left + x * 60 * scale.column, scale.top - y * 20 * scale.row) == pytest.approx((2.4, -2.0), abs=0.6)
    assert middle(above_legend[INKS["path"]]) == pytest.approx((0.5, 0.475), abs=0.02)


def test_fine_map_shows_thinner_lines() -> None:
    """A path's dots take a share of the picture that falls with the resolution."""
    shares = []
    for fine in (2, 4):
        content = picture(grid(), path([(-4.0, 0.0), (4.0, 0.0)]), wish=Wish(width=60, height=20, fine=fine))
        image = drawn(cells_of(content))
        shares.append(len(colours(image)[INKS["path"]]) / (image.width * image.height))
    assert shares[1] < 0.7 * shares[0]


def test_finest_map_stays_within_largest_picture() -> None:
    cells = cells_of(picture(grid(), wish=Wish(width=180, height=40, fine=4)))
    assert cells.fine == 2
    assert len(cells.rows) <= MOST_ROWS
    assert max(map(len, cells.rows)) <= MOST_COLUMNS


def test_text_has_size_of_terminals_characters() -> None:
    canvas = Canvas(80, 40, 2)
    canvas.write(20, 20, "■ 5 m", "path")
    places = colours(drawn(canvas.cells()))[INKS["path"]]
    across, down = zip(*places, strict=True)
    assert min(across) >= 20 / 80
    assert max(across) <= 30 / 80
    assert min(down) >= 20 / 40
    assert max(down) < 22 / 40


def test_operators_goal_is_drawn() -> None:
    cells = cells_of(picture(grid(), wish=Wish(width=60, height=20, fine=2)))
    places = colours(drawn(cells, mark=Marked(30, 10, "→")))[INKS["goal"]]
    assert middle(places) == pytest.approx((30.5 / 60, 10.5 / 20), abs=0.01)


def test_plot_runs_through_its_values() -> None:
    wave = tuple(math.sin(each / 20) for each in range(400))
    series = Series(0.0, 0.1, (Curve("x", wave, wave, 1.0, 0.0),))
    image = drawn(series)
    assert (image.width, image.height, image.shape) == (800, 480, 1.0)
    curve = {(round(x * 800), round(y * 480)) for x, y in colours(image)[INKS["curve"]]}
    left, high = AXIS * 10, 21 * 20 - 1
    low, top = min(wave), max(wave)
    for at in range(5, 400, 7):
        x, y = left + (at + 0.5) * 700 / 400, (top - wave[at]) / (top - low) * high
        assert any((round(x) + dx, round(y) + dy) in curve for dx in (-1, 0, 1) for dy in (-2, -1, 0, 1, 2)), at


def test_text_wider_than_its_cells_is_not_cut_at_the_edge() -> None:
    series = Series(0.0, 1.0, (Curve("x", (0.0, 1.0), (0.0, 1.0), 1.0, 0.5),))
    inks = Inks(PAPER, dict.fromkeys(styles_in(series), (200, 200, 200)), (6.0, 20.0))
    image = image_of(series, (40, 12), 2.0, inks)
    row = 10 * 20  # below the axis: labels of time, the last of which is "now"
    edge = {image.data[3 * (y * image.width + image.width - 1)] for y in range(row, row + 20)}
    assert edge == {PAPER.background[0]}


def test_plot_shows_cursor() -> None:
    series = Series(0.0, 0.1, (Curve("x", (0.0, 1.0), (0.0, 1.0), 1.0, 0.5),))
    assert drawn(series, cursor=7).data != drawn(series).data


@pytest.mark.parametrize("cells", [
    Cells((), fine=2), Cells(("",), fine=2), Cells(("a\u28ff", "▛"), fine=4), Cells(("x" * 400,) * 150, fine=4),
])  # fmt: skip
def test_strangers_cells_are_drawn_within_bounds(cells: Cells) -> None:
    image = drawn(cells)
    assert max(image.width, image.height) <= 4096
