"""Rows of the navigation stage of a finished dataset: its navmesh, as far as it says what agent it is for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.navigation import Navmesh, Split
from tasks.capture.files.documents import read_bytes
from tasks.exports.habitat.navmesh_file import read_polygons
from tasks.ingestion.models import MAX_MODEL_BYTES
from tasks.ingestion.scene import IngestionConfig, Source
from tasks.navigation import split_of
from tasks.stage import Blobs, Outcome


def navigation_rows(source: Source, config: IngestionConfig) -> Outcome | None:
    """The navmesh of a scene and its split; None when the dataset has no navmesh for it. Episodes are not read.

    A navmesh that cannot be read is left out, with a note.
    """
    file = str(source.about.get("navmesh", ""))
    if not file:
        return None
    notes: list[str] = []
    meshes: list[Navmesh] = []
    blobs = Blobs()
    try:
        data = read_bytes(source.root / file, file, MAX_MODEL_BYTES)
        navmesh = read_polygons(data)
    except InputError as error:
        notes.append(f"{error}: left out")
    except ValueError as error:
        notes.append(f"{file}: left out: {error}")
    else:
        if navmesh.settings is None:
            notes.append(f"{file}: of version {navmesh.version}, left out: it does not say for what agent it is")
        else:
            areas = np.array([_plan_area(corners) for corners in navmesh.polygons])
            parts = np.bincount(navmesh.islands, weights=areas) if len(areas) else np.zeros(0)
            meshes.append(
                Navmesh(
                    scene_id=source.scene_id,
                    agent=config.agent,
                    agent_radius_m=float(navmesh.settings["agentRadius"]),
                    agent_height_m=float(navmesh.settings["agentHeight"]),
                    navmesh_blob=blobs.add(data, "navmesh"),
                    area_m2=float(areas.sum()),
                    largest_island_m2=float(parts.max(initial=0.0)),
                    island_count=len(parts),
                    path_finder="imported",
                )
            )
    split = Split(room_id=source.room_id, split=split_of(source.room_id, config.test_share))
    return Outcome(navmeshes=meshes, episodes=[], unreachable_targets=[], splits=[split], blobs=blobs, degradations=notes)


def _plan_area(corners: NDArray[np.float64]) -> float:
    """Area of a polygon of Habitat's frame seen from above [m2]."""
    x, z = corners[:, 0], corners[:, 2]
    return 0.5 * abs(float(x @ np.roll(z, -1) - z @ np.roll(x, -1)))
