"""Export formats: what scenes are written as. The objects are in `tasks.exports`."""

from __future__ import annotations

EXPORT_FORMATS = ("usd", "habitat", "mjcf", "urdf", "glb", "nav2", "sdf")
"""In the order in which they are written."""
