"""Rules of what stands on tops in bedrooms, living rooms and offices."""

from __future__ import annotations

from tasks.furniture.tops.laws import Beside, Rule, either, rule_of, some
from tasks.furniture.tops.zones import (
    ANYWHERE,
    BACK,
    BACK_LEFT,
    BACK_MIDDLE,
    BACK_RIGHT,
    CENTER,
    FOOT,
    FRONT,
    FRONT_LEFT,
    FRONT_MIDDLE,
    FRONT_RIGHT,
    HEAD,
    HIGH,
    LEFT,
    LOW,
    MIDDLE,
    MIDDLE_FRONT,
    RIGHT,
    SEATS,
)

BOOKS = ("book", "book stack")
ROW = (0.19, 0.3, 0.225)
"""Extents of a row of standing books on a shelf [m]."""
THROW = (0.16, 0.42, 0.36)
"""Extents of a pillow that stands [m]."""
FLAT = (0.34, 0.36, 0.13)
"""Extents of a pillow that lies [m]."""

_KEYS = Beside("monitor", (1, 0), (0.08, 0.2), 0.08, FRONT_MIDDLE)
_MOUSE = Beside("keyboard", (0, 1), (0.02, 0.07), 0.03, FRONT_RIGHT)
_PAD = Beside("laptop", (0, 1), (0.03, 0.08), 0.05, FRONT_RIGHT)

BEDROOM: dict[str, Rule] = {
    "bed": rule_of((
        some("pillow", (0.0, 0.2, 0.55, 0.25), HEAD, size=FLAT),
        either((0.65, some("blanket", 1.0, FOOT)), (0.15, some("towel", 1.0, FOOT))),
        some("stuffed animal", 0.45, HEAD),
        some("clothes", (0.55, 0.35, 0.1), ANYWHERE),
        either((0.25, some("laptop", 1.0, CENTER)), (0.15, some("tablet", 1.0, CENTER))),
        some("book", (0.6, 0.3, 0.1), ANYWHERE),
        either((0.2, some("bag", 1.0, ANYWHERE)), (0.1, some("backpack", 1.0, ANYWHERE))),
        some("cell phone", 0.25, ANYWHERE, BOOKS),
    )),
    "nightstand": rule_of((
        some("table lamp", 0.9, BACK, ("book stack",), 0.2),
        either((0.2, some("book stack", 1.0, ANYWHERE)), (0.65, some("book", (0.0, 0.8, 0.2), ANYWHERE))),
        either((0.35, some("mug", 1.0, FRONT, ("book",), 0.3)), (0.3, some("cup", 1.0, FRONT, ("book",), 0.3))),
        some("cell phone", 0.55, FRONT, BOOKS, 0.5),
        either((0.45, some("clock", 1.0, ANYWHERE, BOOKS, 0.4)), (0.25, some("picture", 1.0, BACK)), (0.15, some("candle", 1.0, ANYWHERE))),
        either((0.3, some("tissue box", 1.0, ANYWHERE, size=(0.11, 0.12, 0.12))), (0.15, some("headphones", 1.0, ANYWHERE, BOOKS, 0.5))),
    )),
    "desk": rule_of((
        either(
            (0.45, (some("laptop", 1.0, MIDDLE_FRONT), some("mouse", 0.6, _PAD))),
            (0.35, (some("monitor", 1.0, BACK_MIDDLE), some("keyboard", 0.95, _KEYS), some("mouse", 0.9, _MOUSE))),
        ),
        some("desk lamp", 0.6, BACK_LEFT, ("book stack",), 0.25),
        some("book stack", (0.55, 0.35, 0.1), BACK),
        some("book", (0.35, 0.4, 0.25), ANYWHERE, BOOKS, 0.3),
        some("mug", 0.45, FRONT_RIGHT, ("book",), 0.35),
        either((0.45, some("headphones", 1.0, RIGHT, BOOKS, 0.3)), (0.25, some("speaker", 1.0, BACK_RIGHT))),
        either((0.3, some("picture", 1.0, BACK)), (0.25, some("stuffed animal", 1.0, BACK)), (0.15, some("plant", 1.0, BACK))),
        some("cell phone", 0.4, FRONT, BOOKS, 0.3),
    )),
    "table": rule_of((
        either((0.55, some("mirror", 1.0, BACK_MIDDLE)), (0.25, some("table lamp", 1.0, BACK))),
        some("jar", (0.3, 0.35, 0.35), BACK),
        some("bottle", (0.5, 0.3, 0.2), BACK),
        some("clothes", (0.4, 0.4, 0.2), FRONT),
        some("book", (0.5, 0.3, 0.2), ANYWHERE, BOOKS, 0.3),
        some("picture", (0.5, 0.5), BACK),
        either((0.3, some("stuffed animal", 1.0, ANYWHERE)), (0.25, some("bag", 1.0, ANYWHERE))),
        some("tissue box", 0.35, ANYWHERE),
    )),
    "dresser": rule_of((
        either((0.45, some("mirror", 1.0, BACK_MIDDLE)), (0.2, some("clock", 1.0, FRONT))),
        some("table lamp", 0.35, BACK_LEFT),
        some("picture", (0.35, 0.4, 0.25), BACK),
        some("candle", (0.5, 0.3, 0.2), ANYWHERE),
        some("jar", (0.4, 0.3, 0.3), FRONT),
        some("box", 0.5, ANYWHERE, BOOKS, 0.2),
        either((0.35, some("vase", 1.0, BACK_RIGHT)), (0.25, some("plant", 1.0, BACK_RIGHT))),
        some("clothes", 0.4, ANYWHERE),
        some("stuffed animal", 0.2, ANYWHERE),
    )),
    "cabinet": rule_of((
        some("clothes", (0.35, 0.4, 0.25), ANYWHERE, ("storage bin", "clothes"), 0.6),
        some("box", (0.45, 0.4, 0.15), BACK, ("storage bin",), 0.5),
        some("picture", (0.4, 0.4, 0.2), BACK),
        either((0.4, some("table lamp", 1.0, BACK_LEFT)), (0.3, some("storage bin", 1.0, BACK))),
        some("clock", 0.45, FRONT, ("box", "book stack"), 0.3),
        either((0.35, some("bag", 1.0, RIGHT)), (0.3, some("book stack", 1.0, ANYWHERE))),
        some("stuffed animal", 0.4, BACK, ("box",), 0.3),
    )),
    "bookshelf": rule_of((
        some("book stack", (0.1, 0.25, 0.4, 0.25), ANYWHERE, size=ROW),
        some("picture", (0.4, 0.4, 0.2), MIDDLE),
        some("stuffed animal", (0.35, 0.4, 0.25), ANYWHERE, size=(0.16, 0.18, 0.22)),
        some("box", (0.4, 0.4, 0.2), LOW),
        some("clothes", 0.45, LOW, size=(0.26, 0.26, 0.09)),
        some("candle", 0.4, HIGH),
    )),
    "tv stand": rule_of((
        some("tv", 0.9, BACK_MIDDLE),
        some("remote control", (0.3, 0.5, 0.2), FRONT),
        either((0.3, some("stuffed animal", 1.0, RIGHT)), (0.3, some("picture", 1.0, BACK_RIGHT))),
        some("clock", 0.35, BACK_LEFT),
        some("book", (0.5, 0.3, 0.2), ANYWHERE, BOOKS, 0.3),
        either((0.3, some("candle", 1.0, FRONT)), (0.25, some("jar", 1.0, FRONT))),
        some("clothes", 0.3, LEFT),
    )),
    "side table": rule_of((
        some("table lamp", 0.7, BACK),
        some("book", (0.3, 0.45, 0.25), ANYWHERE, BOOKS, 0.5),
        either((0.45, some("clock", 1.0, ANYWHERE)), (0.3, some("picture", 1.0, BACK))),
        some("cup", (0.4, 0.45, 0.15), FRONT, ("book",), 0.3),
        some("cell phone", 0.5, FRONT, BOOKS, 0.5),
        some("candle", 0.4, ANYWHERE),
    )),
}  # fmt: skip

OFFICE: dict[str, Rule] = {
    "desk": rule_of((
        either(
            (0.6, (some("monitor", (0.0, 0.7, 0.3), BACK_MIDDLE), some("keyboard", 0.95, _KEYS), some("mouse", 0.9, _MOUSE))),
            (0.35, (some("laptop", 1.0, MIDDLE_FRONT), some("mouse", 0.6, _PAD))),
        ),
        some("telephone", 0.55, BACK_LEFT),
        some("paper", (0.35, 0.4, 0.25), FRONT, ("book",), 0.15),
        some("desk organizer", 0.55, BACK_RIGHT),
        some("mug", 0.55, FRONT_RIGHT, ("book",), 0.3),
        some("book", (0.55, 0.45), ANYWHERE, ("book",), 0.4),
        either((0.3, some("desk lamp", 1.0, BACK_LEFT)), (0.2, some("plant", 1.0, BACK))),
        either((0.2, some("headphones", 1.0, RIGHT)), (0.15, some("printer", 1.0, BACK_LEFT)), (0.15, some("cell phone", 1.0, FRONT))),
    )),
    "table": rule_of((
        some("laptop", (0.2, 0.3, 0.3, 0.2), SEATS),
        some("mouse", (0.5, 0.3, 0.2), Beside("laptop", (0, 1), (0.03, 0.08), 0.05, ANYWHERE)),
        some("paper", (0.2, 0.4, 0.4), SEATS),
        some("telephone", 0.5, CENTER),
        some("mug", (0.35, 0.35, 0.3), Beside("laptop", (-1, 1), (0.02, 0.06), 0.02, ANYWHERE)),
        some("projector", 0.35, CENTER),
        some("cell phone", 0.45, ANYWHERE, ("paper",), 0.4),
    )),
    "cabinet": rule_of((
        either((0.6, some("printer", 1.0, BACK_LEFT, size=(0.28, 0.36, 0.2))), (0.2, some("projector", 1.0, BACK))),
        some("paper", (0.25, 0.4, 0.35), FRONT, ("printer", "storage bin"), 0.8, size=(0.21, 0.26, 0.02)),
        some("box", (0.45, 0.45, 0.1), ANYWHERE, ("printer", "storage bin"), 0.5),
        some("book stack", (0.4, 0.6), BACK),
        some("desk organizer", 0.5, ANYWHERE),
        either((0.35, some("telephone", 1.0, FRONT)), (0.2, some("storage bin", 1.0, RIGHT, size=(0.22, 0.27, 0.16)))),
        some("plant", 0.3, BACK_RIGHT),
    )),
    "bookshelf": rule_of((
        some("book stack", (0.05, 0.2, 0.35, 0.4), ANYWHERE, size=ROW),
        some("box", (0.3, 0.4, 0.3), LOW),
        some("desk organizer", (0.35, 0.4, 0.25), MIDDLE),
        some("book", (0.45, 0.35, 0.2), ANYWHERE, BOOKS, 0.3),
        some("paper", (0.5, 0.5), MIDDLE, size=(0.21, 0.28, 0.03)),
        either((0.2, some("plant", 1.0, HIGH, size=(0.15, 0.15, 0.22))), (0.2, some("speaker", 1.0, HIGH, size=(0.15, 0.14, 0.23)))),
    )),
    "side table": rule_of((
        some("telephone", 0.6, BACK_RIGHT, size=(0.16, 0.14, 0.07)),
        either((0.3, some("printer", 1.0, LEFT, size=(0.26, 0.3, 0.18)))),
        some("paper", (0.3, 0.45, 0.25), ANYWHERE, ("printer", "book"), 0.9, size=(0.19, 0.13, 0.01)),
        some("mug", (0.35, 0.5, 0.15), FRONT, ("book",), 0.5),
        some("desk organizer", 0.5, ANYWHERE, ("printer",), 0.4, size=(0.09, 0.16, 0.11)),
        some("book", (0.3, 0.45, 0.25), ANYWHERE, ("book", "printer"), 0.8),
    )),
    "coffee table": rule_of((
        some("mug", (0.2, 0.35, 0.3, 0.15), ANYWHERE, ("book",), 0.25),
        some("paper", (0.25, 0.4, 0.35), ANYWHERE, BOOKS, 0.3),
        some("laptop", 0.5, FRONT_MIDDLE),
        some("telephone", 0.3, LEFT),
        some("book", (0.4, 0.35, 0.25), ANYWHERE, ("book",), 0.4),
        some("cell phone", (0.5, 0.35, 0.15), FRONT, BOOKS, 0.3),
        some("plant", 0.3, CENTER),
    )),
    "sofa": rule_of((
        some("pillow", (0.2, 0.4, 0.4), HEAD, size=THROW),
        some("backpack", (0.5, 0.4, 0.1), ANYWHERE),
        some("laptop", 0.5, ANYWHERE),
        some("paper", (0.35, 0.35, 0.3), FRONT, BOOKS, 0.3),
        some("headphones", 0.3, ANYWHERE),
        some("clothes", 0.4, ANYWHERE),
        some("book", 0.45, ANYWHERE),
    )),
}  # fmt: skip

LIVING_ROOM: dict[str, Rule] = {
    "sofa": rule_of((
        some("pillow", (0.05, 0.15, 0.3, 0.3, 0.2), HEAD, size=(0.16, 0.36, 0.34)),
        some("blanket", 0.5, LEFT, size=(0.4, 0.4, 0.09)),
        some("remote control", (0.5, 0.35, 0.15), FRONT, BOOKS, 0.2),
        some("stuffed animal", 0.25, FRONT),
        some("book", 0.35, FRONT),
        either((0.2, some("tablet", 1.0, FRONT)), (0.15, some("cell phone", 1.0, FRONT))),
    )),
    "coffee table": rule_of((
        some("remote control", (0.2, 0.5, 0.3), ANYWHERE, BOOKS, 0.25),
        some("book", (0.3, 0.35, 0.35), ANYWHERE, BOOKS, 0.4),
        either((0.4, some("bowl", 1.0, CENTER)), (0.3, some("vase", 1.0, CENTER, ("book stack",), 0.2))),
        some("candle", (0.45, 0.3, 0.25), CENTER),
        some("mug", (0.4, 0.4, 0.2), FRONT, ("book",), 0.25),
        either((0.2, some("tablet", 1.0, FRONT)), (0.2, some("tissue box", 1.0, ANYWHERE))),
        some("plant", 0.2, ANYWHERE),
    )),
    "side table": rule_of((
        some("table lamp", 0.65, BACK, ("book stack",), 0.2),
        some("remote control", (0.4, 0.5, 0.1), FRONT, BOOKS, 0.4),
        some("book", (0.5, 0.35, 0.15), ANYWHERE, BOOKS, 0.5),
        either((0.35, some("plant", 1.0, BACK, size=(0.14, 0.14, 0.24))), (0.25, some("vase", 1.0, BACK))),
        either((0.4, some("picture", 1.0, BACK)), (0.3, some("candle", 1.0, ANYWHERE))),
        some("mug", 0.45, FRONT, ("book",), 0.3),
        some("telephone", 0.2, FRONT),
    )),
    "tv stand": rule_of((
        some("tv", 0.95, BACK_MIDDLE),
        either((0.4, (some("speaker", 1.0, LEFT), some("speaker", 1.0, RIGHT))), (0.2, some("speaker", 1.0, LEFT))),
        some("remote control", (0.25, 0.5, 0.25), FRONT),
        some("plant", 0.3, RIGHT),
        either((0.3, some("vase", 1.0, RIGHT)), (0.25, some("sculpture", 1.0, RIGHT))),
        some("camera", 0.15, FRONT),
        some("picture", (0.6, 0.3, 0.1), BACK),
    )),
    "bookshelf": rule_of((
        some("book stack", (0.1, 0.3, 0.35, 0.25), ANYWHERE, size=ROW),
        some("vase", (0.45, 0.4, 0.15), MIDDLE, size=(0.12, 0.12, 0.22)),
        some("picture", (0.3, 0.4, 0.3), MIDDLE),
        some("plant", (0.5, 0.35, 0.15), HIGH, size=(0.15, 0.15, 0.22)),
        some("sculpture", (0.45, 0.4, 0.15), HIGH, size=(0.13, 0.13, 0.22)),
        some("speaker", (0.75, 0.25), MIDDLE, size=(0.15, 0.14, 0.23)),
    )),
    "desk": rule_of((
        some("laptop", 0.65, MIDDLE_FRONT),
        some("book", (0.35, 0.35, 0.3), LEFT, BOOKS, 0.4),
        some("plant", (0.35, 0.45, 0.2), BACK),
        some("picture", (0.3, 0.4, 0.3), BACK),
        some("table lamp", 0.45, BACK_LEFT),
        some("vase", 0.4, BACK_RIGHT),
        either((0.3, some("speaker", 1.0, BACK_RIGHT)), (0.2, some("telephone", 1.0, RIGHT))),
        some("remote control", 0.3, FRONT),
    )),
    "table": rule_of((
        either((0.45, some("vase", 1.0, CENTER)), (0.3, some("plant", 1.0, CENTER))),
        some("remote control", (0.3, 0.4, 0.3), ANYWHERE, BOOKS, 0.25),
        some("book", (0.25, 0.35, 0.4), ANYWHERE, BOOKS, 0.4),
        some("candle", (0.5, 0.3, 0.2), CENTER),
        some("picture", (0.6, 0.3, 0.1), BACK),
        some("tablet", 0.4, SEATS),
        some("speaker", 0.3, BACK),
        some("telephone", 0.2, LEFT),
    )),
    "cabinet": rule_of((
        some("picture", (0.25, 0.35, 0.25, 0.15), BACK),
        some("vase", (0.4, 0.4, 0.2), BACK),
        some("sculpture", (0.5, 0.5), ANYWHERE, ("book stack",), 0.2),
        some("candle", (0.4, 0.3, 0.3), FRONT),
        either((0.35, some("plant", 1.0, BACK_RIGHT)), (0.3, some("table lamp", 1.0, BACK_RIGHT))),
        either((0.2, (some("speaker", 1.0, LEFT), some("speaker", 1.0, RIGHT))), (0.2, some("speaker", 1.0, BACK_LEFT))),
        some("telephone", 0.2, FRONT_LEFT),
    )),
}  # fmt: skip
