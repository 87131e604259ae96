"""Names of pictures that their tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

OPEN_VIEW = Place("rsb_extras.pictures.link_views", "LinkViews.open")
GRAPHICS_CHUNK = Place("rsb_extras.pictures.graphics", "_CHUNK")
ASK_TERMINAL = Place("rsb_extras.pictures.look_command", "ask")
IMAGE_OF = Place("rsb_extras.pictures.image_style", "image_of")
LOOK_SETTLES_IN = Place("rsb_extras.pictures.look_command", "_SETTLE_SECONDS")
LOOK_TIME = Place("rsb_extras.pictures.look_command", "time")
LOOK_WAIT = Place("rsb_extras.pictures.look_command", "wait")
PICTURE_DECODER = Place("rsb_extras.pictures.picture", "_decoder")
DRAW = Place("rsb_extras.pictures.renderer", "Renderer.draw")
DRAWING_SLOW = Place("rsb_extras.pictures.renderer", "_SLOW")
DRAWING_WITHIN = Place("rsb_extras.pictures.renderer", "SECONDS")
CHECK_VIEW = Place("rsb_extras.pictures.topic_view", "TopicView.check")
VIEW_FRAMES = Place("rsb_extras.pictures.topic_view", "FRAMES")
VIEW_MESSAGE_LIMIT = Place("rsb_extras.pictures.topic_view", "MESSAGE_LIMIT")
VIEW_RESOLVE_EVERY = Place("rsb_extras.pictures.topic_view", "_RESOLVE_EVERY")
VIEW_REPLACE_FILE = Place("rsb_extras.pictures.picture_tile", "replace_file")
VIEW_TIME = Place("rsb_extras.pictures.picture_tile", "time")
VIEW_TRIED_AGAIN_AFTER = Place("rsb_extras.pictures.picture_tile", "_TRIED_AGAIN_AFTER")
CHECK_NAMES = Place("rsb_extras.pictures.viewing", "check_names")
LOOK_WAITS_AT_MOST = Place("rsb_extras.pictures.viewing", "WAITS_AT_MOST")
TRIAL = Place("rsb_extras.pictures.confinement_check", "subprocess.run")
