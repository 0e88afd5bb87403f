"""Rows of the candidates stage: ten assets that could stand in for an instance, and the layouts of their textures."""

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
    call_id: str | None = column("Call of the generator, or of the program that painted it", pattern=CALL_PATTERN)
    library: str | None = column("Library of the lake that it was found in; null for others, and for a folder")
    library_file: str | None = column("File of a library that it was found as, relative to it")
    library_score: float | None = column("How well it fits, by which a library's are ranked; larger is better", minimum=-1, maximum=1)
    twin_of: int | None = column(
        "Slot of the candidate whose textured twin, the same solid painted anew, this is; was to be, where it is empty or a fallback",
        minimum=1,
        maximum=10,
    )
    seen_share: float | None = column("Of a twin's texture, the share that the scan's frames show", minimum=0, maximum=1)
    seconds: float | None = column(
        "What filling the slot took; what slots share is counted with the first, what a ledger knows takes nothing",
        unit="s",
        minimum=0,
        volatile=True,
    )


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
    source_url: str | None = column("Page or address of the source, where one is stated")
    mesh_blob: str = column("Geometry with colors or textures, GLB", blob=True)
    pieces_blob: str | None = column("Convex pieces known from construction, GLB with one node each", blob=True)
    thumbnail_blob: str | None = column("Small picture on white, from before, to the left and above, PNG", blob=True)
    extents: tuple[float, ...] = column("Extents of the canonical box along x, y, z", unit="m", length=3, minimum=0)
    volume_m3: float = column("Volume of the solid, of its convex hull when it is not closed", unit="m3", minimum=0)
    is_watertight: bool = column("The mesh is closed")
    open_reason: str | None = column("Why it is not closed: edges of one face, or of more than two")
    has_texture: bool | None = column("It has a picture on it; else colors at its vertices")
    vertex_count: int = column("Vertices", minimum=4)
    face_count: int = column("Faces", minimum=4)


@record("texture_charts", key=("asset_id",), stage="candidates", grain="asset", rule="share", shared_by="candidates")
class TextureCharts:
    """How an asset's surface is laid out in its texture: of every twin, and of models that came with one picture and places in it."""

    asset_id: str = column("Asset that has the layout", pattern=r"[0-9a-f]{64}")
    of_asset_id: str | None = column("Asset that it is the twin of; missing where the layout came with it", pattern=r"[0-9a-f]{64}")
    method: str = column("Who made the layout: an unwrapper, the program that painted it, or source for what came with it")
    made_by: str | None = column("Tool with its version; missing where nobody says")
    side_px: int = column("Longer side of the texture", unit="px", minimum=1)
    faces: int = column("Triangles", minimum=1)
    charts: int = column("Pieces that are connected in the texture, by edges", minimum=0)
    stretch_l2: float = column("Root mean square of the stretch (Sander et al. 2001), weighted by area; 1 is best", minimum=0)
    stretch_linf: float = column("Largest stretch of a triangle, on the same scale", minimum=0)
    angle_distortion_radians: float = column("Mean difference of angles on the surface and in the texture, by area", unit="rad", minimum=0)
    coverage: float = column("Share of the unit square that triangles cover", minimum=0, maximum=1)
    overlap_share: float = column("Share of what is covered that more than one triangle covers", minimum=0, maximum=1)
    flipped: int = column("Triangles that lie mirrored against most of their chart", minimum=0)
    outside: int = column("Triangles with a corner outside of the unit square", minimum=0)
    collapsed: int = column("Triangles with an area on the surface and none in the texture", minimum=0)
    seam_ratio: float = column("Length of all cuts over the diagonal of the asset's box", minimum=0)
    seconds: float | None = column("What laying it out took; missing where it came with the asset", unit="s", minimum=0, volatile=True)
