"""What one foreign file may cost: bytes, pixels, faces, nodes, depth and seconds. Checked before anything is unpacked."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Budget:
    """Bounds that every reader of foreign files keeps. A worker with 8 GB reads whatever lies within them.

    scene_bytes: A scan's mesh, a GLB of a scene, the stage of a dataset. model_bytes: A model of one object.
    asset_bytes: A file of a library; larger ones are whole scenes. image_bytes: An uncompressed image of `pixels`.
    json_bytes: JSON with a number for every vertex. text_bytes: Metadata, poses and tracks of cameras: 16 MiB hold one of
    100,000 frames. table_bytes: A table as text. sens_bytes: ScanNet's longest scans have 5 GB; a walk of an hour at full rate
    stays below this. annotation_bytes, review_bytes, trajectories_bytes: One file of a batch. statement_bytes: SQL; the longest
    statements name thousands of scenes. xml_bytes: A model with its meshes written inside.
    settings_bytes: A file that a person wrote. glb_json_bytes: The JSON of a GLB, whose meshes lie elsewhere.
    unpacked_bytes: What a compressed file holds. memory_bytes: What the values of a JSON document take; one of many small
    values is refused for it long before its own bytes are too many.
    zero_bytes: Numbers that a GLB does not hold, but asks for; one as large as its file is fine, too.
    pixels: One image: 8192 x 8192. all_pixels: All images of a file. drawn_pixels: The same, as often as a part shows them.
    faces, vertices: As often as they are placed. nodes: Nodes of a tree, and parts of meshes as often as they are placed.
    prims, arcs, layers: Of a USD stage once it is composed: prims, sites that one prim is composed of, and layers as often as they are
    named. Composing 150,000 prims takes 6 s.
    depth: Nodes above one another, values inside values. elements: Elements of XML, attributes in them.
    frames: Of one container: four hours and a half at full rate.
    seconds, child_bytes: Computing time and memory of a reader that has no bounds of its own and gets a process (`flows.run.bounds`).
    child_seconds_per_mb, child_bytes_per_byte: More of both for every byte of the file.
    """

    scene_bytes: int = 2 * 2**30
    model_bytes: int = 512 * 2**20
    asset_bytes: int = 256 * 2**20
    image_bytes: int = 256 * 2**20
    json_bytes: int = 512 * 2**20
    text_bytes: int = 16 * 2**20
    table_bytes: int = 64 * 2**20
    sens_bytes: int = 128 * 2**30
    annotation_bytes: int = 64 * 2**20
    review_bytes: int = 2**20
    trajectories_bytes: int = 256 * 2**20
    statement_bytes: int = 16 * 2**20
    xml_bytes: int = 256 * 2**20
    settings_bytes: int = 2**20
    glb_json_bytes: int = 64 * 2**20
    unpacked_bytes: int = 512 * 2**20
    memory_bytes: int = 7 * 2**28
    zero_bytes: int = 64 * 2**20
    pixels: int = 2**26
    all_pixels: int = 2**29
    drawn_pixels: int = 2**32
    faces: int = 20_000_000
    vertices: int = 60_000_000
    nodes: int = 32_768
    prims: int = 131_072
    arcs: int = 4096
    layers: int = 4096
    depth: int = 256
    elements: int = 1_000_000
    frames: int = 500_000
    seconds: float = 25.0
    child_bytes: int = 3 * 2**29
    child_seconds_per_mb: float = 1.0
    child_bytes_per_byte: int = 8


BUDGET = Budget()
"""The one that holds."""
