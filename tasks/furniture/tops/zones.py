"""Parts of a top by name. Left and right are those of who sits or stands before it."""

from __future__ import annotations

from tasks.furniture.tops.laws import Seats, Zone

ANYWHERE = Zone()
BACK = Zone((-1.0, -0.6))
BACK_LEFT = Zone((-1.0, -0.5), (-1.0, -0.5))
BACK_MIDDLE = Zone((-1.0, -0.75), (-0.2, 0.2))
BACK_RIGHT = Zone((-1.0, -0.5), (0.5, 1.0))
CENTER = Zone((-0.25, 0.25), (-0.3, 0.3))
FRONT = Zone((0.3, 1.0))
FRONT_LEFT = Zone((0.2, 1.0), (-1.0, -0.4))
FRONT_MIDDLE = Zone((0.3, 0.8), (-0.25, 0.25))
FRONT_RIGHT = Zone((0.2, 1.0), (0.4, 1.0))
HEAD = Zone((-1.0, -0.8))
FOOT = Zone((0.55, 1.0), (-0.4, 0.4))
LEFT = Zone((-1.0, 1.0), (-1.0, -0.5))
MIDDLE_FRONT = Zone((-0.1, 0.5), (-0.4, 0.4))
RIGHT = Zone((-1.0, 1.0), (0.5, 1.0))
SEATS = Seats()
LOW = Zone(levels=(0.0, 0.4))
MIDDLE = Zone(levels=(0.3, 0.8))
HIGH = Zone(levels=(0.6, 1.0))
