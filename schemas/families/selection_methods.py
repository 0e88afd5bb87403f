"""Selection methods: by what the candidates of an instance are scored. The objects are in `tasks.selection.methods`."""

from __future__ import annotations

SELECTION_METHODS = (
    "geometric",
    "model",
    "extents",
    "color_histogram",
    "image_similarity",
    "clip",
    "acdc",
    "vision_language",
)
"""The first is the default, and stands in where another one lacks what it needs."""
