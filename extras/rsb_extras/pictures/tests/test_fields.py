"""All fields of any message, as a tree."""

from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import LaserScan

from rsb_extras.pictures.picture import Wish
from rsb_extras.pictures.tests.samples import cells_of, drawn, task
from rsb_extras.pictures.worker import Artist


def test_fields_and_values_are_shown() -> None:
    message = PoseStamped()
    message.header.frame_id = "map"
    message.pose.position.x = 1.5
    text = "\n".join(cells_of(drawn(Wish(width=40, height=20, how="tree"), message)).rows)
    assert "frame_id: map" in text
    assert "x: 1.5" in text


def test_changed_values_are_marked() -> None:
    artist, message = Artist(), PoseStamped()
    wish = Wish(width=40, height=20, how="tree")
    artist.do(task(wish, message))
    message.pose.position.y = 2.0
    picture = artist.do(task(wish, message))
    assert picture is not None
    content, at = cells_of(picture), 0
    strong = content.palette.index("strong")
    for row in content.rows:
        marked = strong in content.styles[at : at + len(row)]
        assert marked == row.strip().startswith("y: 2")
        at += len(row)


def test_long_arrays_are_cut() -> None:
    content = cells_of(drawn(Wish(width=100, height=20, how="tree"), LaserScan(ranges=[1.0] * 720)))
    assert any("720 × float32" in row for row in content.rows)
