"""Path finders: where an agent can go, and how far it is. The objects are in `tasks.navigation`."""

from __future__ import annotations

PATH_FINDERS = ("planar", "recast", "habitat")
"""The first is the default."""
