"""What stands on tops: rules with stated distributions, for kinds of large objects in kinds of rooms.

>>> top = draw("desk", typical_size("desk", rng), "office", rng)

The same generator state, word, size and kind of room give the same top.
"""

from __future__ import annotations

from tasks.furniture.tops.drawing import PAIRS, Top, draw, rule, stated_count, stated_distribution
from tasks.furniture.tops.furnishing import furnished
from tasks.furniture.tops.sizes import typical_size

__all__ = ["PAIRS", "Top", "draw", "furnished", "rule", "stated_count", "stated_distribution", "typical_size"]
