"""Learned systems: what can be trained on rows of the lake. The objects are in `tasks.training.systems`."""

from __future__ import annotations

LEARNED_SYSTEMS = ("selection", "synthesis", "navigation")
