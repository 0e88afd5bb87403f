"""The path finders."""

from __future__ import annotations

from schemas.families.path_finders import PATH_FINDERS as NAMES
from tasks.families import members
from tasks.navigation.protocol import PathFinderKind

PATH_FINDERS = members("tasks.navigation", NAMES, PathFinderKind)
"""The first is the default: it needs no native library."""
