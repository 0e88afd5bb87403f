"""Actions as numbers: places in `schemas.evaluation.ACTIONS`, and what stands in for a last action where there is none."""

from __future__ import annotations

from schemas.evaluation import ACTIONS
from tasks.navigation import follower

FORWARD, LEFT, RIGHT, STOP = map(ACTIONS.index, (follower.FORWARD, follower.LEFT, follower.RIGHT, follower.STOP))

START, UNTOLD = len(ACTIONS), len(ACTIONS) + 1
"""Last actions of a first step, and of one of which nothing is said."""

UNKNOWN = -1
"""Of a step whose right action nobody knows: nothing is learned of it."""
