"""Rows of the candidates stage: ten assets that could stand in for an instance."""

from __future__ import annotations

from schemas.calls import CALL_PATTERN
from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record


@record("candidates", key=("scene_id", "instance_id", "slot"), stage="candidates")
class Candidate:
    """What one of the ten slots of an instance was filled with, or why it is empty."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    slot: int = column("Slot", minimum=1, maximum=10)
    provider: str = column("Who filled the slot")
    provider_version: str = column("Version of the provider or model")
    is_fallback: bool = column("True when the slot's provider had nothing and another filled it")
    outcome: str = column("What came of it", values=("filled", "empty", "failed"))
    reason: str | None = column("Why the slot is empty, failed or filled by a fallback")
    asset_id: str | None = column("Asset in the slot", pattern=r"[0-9a-f]{64}")
    seed: int | None = column("Seed that a generator was given", minimum=0)
    call_id: str | None = column("Call of the generator that made it", pattern=CALL_PATTERN)
    library: str | None = column("Library of the lake that it was found in; null for others, and for a folder")
    library_file: str | None = column("File of a library that it was found as, relative to it")
    library_score: float | None = column("How well it fits, by which a library's are ranked; larger is better", minimum=-1, maximum=1)


@record("assets", key=("asset_id",), stage="candidates", grain="asset", rule="share", shared_by="candidates")
class Asset:
    """A canonical asset: +Z up, front +X, metres, origin at the bottom center of its box, never scaled."""

    asset_id: str = column("Hash of the asset's GLB", pattern=r"[0-9a-f]{64}")
    provider: str = column("Who made or found it")
    name: str = column("Name: the library's file stem, the generator's model and seed, ...")
    category: str = column("What it depicts")
    source: str = column("Where it came from: file in the library, generator, scan")
    license: str = column("Licence, SPDX identifier where there is one")
    author: str | None = column("Author, where one is known")
    mesh_blob: str = column("Geometry with colors or textures, GLB", blob=True)
    pieces_blob: str | None = column("Convex pieces known from construction, GLB with one node each", blob=True)
    extents: tuple[float, ...] = column("Extents of the canonical box along x, y, z", unit="m", length=3, minimum=0)
    volume_m3: float = column("Volume of the solid, of its convex hull when it is not closed", unit="m3", minimum=0)
    is_watertight: bool = column("The mesh is closed")
    open_reason: str | None = column("Why it is not closed: edges of one face, or of more than two")
    has_texture: bool | None = column("It has a picture on it; else colors at its vertices")
    vertex_count: int = column("Vertices", minimum=4)
    face_count: int = column("Faces", minimum=4)
