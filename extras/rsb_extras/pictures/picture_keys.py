"""The key that looks at any topic, and the keys on pictures."""

from __future__ import annotations

from rsb_console.feature_console import Action, Group, KeyChapter, late

_KEYS = (
    KeyChapter(
        "Tiles (V, also V on a picture)",
        "ViewScreen",
        (
            ("V", "Add a tile: a topic of either side, a layout, the rates, the log"),
            ("tab", "Go on to the next tile; shift+tab back"),
            ("z", "Give it the whole screen, or show all again; what is hidden costs nothing"),
            ("x", "Close it"),
            ("w", "Keep the tiles as a layout, which V lists"),
        ),
    ),
    KeyChapter(
        "On a picture (v, V)",
        "ViewScreen",
        (
            ("esc q v", "Close it, with all other tiles"),
            ("t", "Show the messages as text, or as a picture again"),
            ("space", "Hold the picture; the topic goes on"),
            ("+ - 0", "Zoom in, zoom out, show all; of a plot: a shorter or a longer time"),
            ("← → ↑ ↓", "Move the view; on a plot, the cursor"),
            ("[ ] c", "Of points: tilt the view, change what their colours mean"),
            ("h", "Draw it in another way: usual, plot, tree"),
            ("f", "Choose numbers to plot, of this topic and of others"),
            ("l", "Of a map: lay other topics over it, costmaps, too, or show it alone"),
            ("< >", "Fewer or more pictures a second"),
            ("p", "Write the picture to a file: an image in its own resolution, and as this terminal draws it"),
        ),
    ),
    KeyChapter(
        "Goal on a map",
        "ViewScreen",
        (
            ("g", "Begin to set a goal"),
            ("← → ↑ ↓", "Move it; after ⏎, turn it"),
            ("⏎", "Go on to its heading, then to the form that publishes it"),
            ("esc", "Leave it"),
        ),
    ),
)
LOOK = Action(
    "look",
    "V",
    "look",
    "Look at any topic of either side: images, maps, scans, plots",
    Group.VIEW,
    also="camera, picture, view, tf, diagnostics",
    run=late("rsb_extras.pictures.view_screen:look"),
    after="message",
    chapters=_KEYS,
)
