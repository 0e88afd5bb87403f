"""Rows of the capture stage: what one scan says about its scene."""

from __future__ import annotations

from typing import Literal, get_args

from schemas.families.scan_formats import SCAN_FORMATS
from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record

DatasetLayout = Literal["metascenes", "habitat"]

DATASET_LAYOUTS: tuple[DatasetLayout, ...] = get_args(DatasetLayout)
"""Layouts of finished datasets that are read."""

SYNTHESIS = "synthesis"
"""Format of scenes that no scan shows: a model drew them."""


SURFACE_PATTERN = r"floor|ceiling|(wall|inner)_[0-9]{2,}"
"""A part of the room's shell, with all pieces that openings cut it into."""


@record("scenes", key=("scene_id",), stage="capture")
class Scene:
    """A scene: what the lake holds of one scan."""

    scene_id: str = column("Scene, <dataset>/<scan>", pattern=SCENE_PATTERN)
    room_id: str = column("Physical room, or dwelling of several, the unit of train/test splits", pattern=SCENE_PATTERN)
    dataset: str = column("Dataset that the scan belongs to")
    scan: str = column("Name of the scan in its dataset")
    scan_format: str = column(
        "Format that the scan was read from; metascenes and habitat are finished datasets, whose own objects stand for the scan; synthesis "
        "is no scan: a model drew what is there",
        values=(*SCAN_FORMATS, *DATASET_LAYOUTS, SYNTHESIS),
    )
    scan_path: str = column("Folder or file of the scan when it was read", volatile=True)
    alignment: tuple[float, ...] = column("Scan frame to world frame, 4x4 row by row", unit="m", length=16)
    alignment_source: str = column(
        "Where the alignment came from; format is the format's convention of which axis is up",
        values=("file", "estimated", "identity", "format"),
    )
    to_original: tuple[float, ...] = column(
        "World frame to the coordinates, axes and units of the scan's file, 4x4 row by row: the offset of a survey, and the scale of "
        "a file in other units",
        length=16,
    )
    floor_tilt_radians: float | None = column(
        "Angle between the scan's floor and the horizontal before alignment; missing when nobody measured it", unit="rad", minimum=0
    )
    mesh_blob: str = column(
        "Scan mesh in the world frame, GLB with vertex colors or textures; of a finished dataset its stage, else its objects",
        blob=True,
    )
    vertex_count: int = column("Vertices of the scan mesh", minimum=3)
    face_count: int = column("Faces of the scan mesh", minimum=1)
    frame_count: int = column("Frames of the scan, with or without a usable pose", minimum=0)
    instance_count: int = column("Instances in the scene", minimum=0)
    segmentation: str = column(
        "Where the instances came from: the scan's files, its geometry, or the objects of a finished dataset",
        values=("file", "geometry", "objects"),
    )
    license: str | None = column("Licence of the scan, when its folder states one")


@record("shells", key=("scene_id",), stage="capture")
class Shell:
    """What encloses a scene, all its rooms together, estimated from its scan: outline, walls, openings, height."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    room_type: str = column(
        "Kind of the whole: what the scan states, else the kind of its one room; 'dwelling' for several rooms of which nobody says what "
        "they are together; 'unknown' when neither stated nor inferred"
    )
    floor_polygon: tuple[tuple[float, ...], ...] = column(
        "Corners of the outline of all rooms with the walls between them, world frame, counter-clockwise, open ring of (x, y)", unit="m"
    )
    floor_area_m2: float = column("Area of the outline, walls between rooms included", unit="m2", minimum=0)
    floor_source: str = column(
        "What the outline was estimated from; layout is stated by a finished dataset", values=("surface", "walls", "extent", "layout")
    )
    walls: tuple[tuple[float, ...], ...] = column(
        "Walls as segments (x0, y0, x1, y1) in the world frame, both faces of interior ones; the room lies to their left", unit="m"
    )
    interior_walls: tuple[tuple[float, ...], ...] = column(
        "Walls inside the outline as center lines with thickness and height (x0, y0, x1, y1, thickness, height)", unit="m"
    )
    openings: tuple[tuple[float, ...], ...] | None = column(
        "Doors, windows and passages in the walls: segment (x0, y0, x1, y1) on the inner face of an outer wall or the center line of "
        "an interior one, heights of bottom and top, how far a filling reaches behind that line, 0 for none; missing where nobody looked",
        unit="m",
    )
    lintels: tuple[tuple[float, ...], ...] | None = column(
        "What was seen of walls inside the outline over the doorways between them: center lines from the end of the wall that goes on, "
        "with thickness and heights of bottom and top (x0, y0, x1, y1, thickness, bottom, top); missing where nobody looked",
        unit="m",
    )
    slopes: tuple[tuple[float, ...], ...] | None = column(
        "Slanted walls below a roof: segment (x0, y0, x1, y1) on the inner face of an outer wall, height at which they begin there, how "
        "far into the room they reach at the ceiling; missing where nobody looked",
        unit="m",
    )
    height_m: float = column("Height from floor to ceiling", unit="m", minimum=0.1)
    height_source: str = column(
        "What the height was estimated from; layout is stated by a finished dataset, assumed is that of most rooms, where scans end lower",
        values=("ceiling", "walls", "extent", "layout", "assumed"),
    )
    floor_color: tuple[int, ...] | None = column(
        "Median color of the floor in the scan, sRGB; missing when unseen", length=3, minimum=0, maximum=255
    )
    wall_color: tuple[int, ...] | None = column(
        "Median color of the walls in the scan, sRGB; missing when unseen", length=3, minimum=0, maximum=255
    )


@record("surfaces", key=("scene_id", "surface"), stage="capture")
class RoomSurface:
    """How a floor, wall or ceiling looks in the scan: an image of it, with what was hidden filled in from around it."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    surface: str = column("Part of the room: floor, ceiling, wall_00, inner_00", pattern=SURFACE_PATTERN)
    texture_blob: str = column("Its image, sRGB, JPEG, upright to who looks at it from the room", blob=True)
    origin: tuple[float, ...] = column("Where the image's lower left corner lies in the world frame", unit="m", length=3)
    u_axis: tuple[float, ...] = column("Direction from the left to the right of the image in the world frame, unit", length=3)
    v_axis: tuple[float, ...] = column("Direction from the bottom to the top of the image in the world frame, unit", length=3)
    width_m: float = column("How much the image shows from left to right", unit="m", minimum=0)
    height_m: float = column(
        "How much the image shows from bottom to top; of interior walls both sides: the left one as it stands, on it the right one, "
        "upside down, as a cloth hangs over the wall",
        unit="m",
        minimum=0,
    )
    texel_m: tuple[float, ...] = column("Width and height of a pixel on the surface", unit="m", length=2, minimum=0)
    seen_share: float = column("Share of the surface, without its doors and windows, that the scan shows", minimum=0, maximum=1)
    color: tuple[int, ...] = column("Median color of what the scan shows of it, sRGB", length=3, minimum=0, maximum=255)


@record("rooms", key=("scene_id", "room_index"), stage="capture")
class Room:
    """One room of a scene: what of its floor lies between walls, doorways closed."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    room_index: int = column("Number of the room in the scene, the largest first", minimum=0, earlier=0)
    room_type: str = column("Kind of room (bedroom, office, ...), 'unknown' when neither stated nor inferred")
    floor_polygon: tuple[tuple[float, ...], ...] = column(
        "Corners of the room's floor between its walls, world frame, counter-clockwise, open ring of (x, y)", unit="m"
    )
    floor_area_m2: float = column("Area of the floor polygon", unit="m2", minimum=0)


@record("frames", key=("scene_id", "frame_id"), stage="capture")
class Frame:
    """A posed frame of a scan. Pixels stay where the scan is; this refers to them."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    frame_id: str = column("Frame, zero-padded", pattern=r"[0-9]{6}")
    color_file: str = column("Color image relative to the scan; '<file>.sens#<index>' inside a container")
    depth_file: str | None = column("Depth image relative to the scan; '<file>.sens#<index>' inside a container")
    width: int = column("Width of the color image", unit="px", minimum=1)
    height: int = column("Height of the color image", unit="px", minimum=1)
    intrinsics: tuple[float, ...] = column("fx, fy, cx, cy of the color camera", unit="px", length=4)
    depth_scale: float = column("Depth units per metre", unit="1/m", minimum=1)
    pose: tuple[float, ...] | None = column(
        "Camera (x right, y down, z forward) to world frame, 4x4 row by row; missing when unreadable", unit="m", length=16
    )
    pose_source: str | None = column(
        "Whose the pose is: the scan's files', refined from it by the frames' depth, or estimated from color and depth alone; missing "
        "where there is no pose, and in rows that are older than the column",
        values=("file", "refined", "estimated"),
    )


@record("instances", key=("scene_id", "instance_id"), stage="capture")
class Instance:
    """One object, or a wall, floor or ceiling, of a scene."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance, zero-padded, unique in the scene", pattern=INSTANCE_PATTERN)
    source_id: str = column("What the scan calls the instance (object id, node name)")
    raw_label: str = column("Label as the scan has it")
    category: str = column("Label, lower case, single spaces, no plural where the label map says so")
    nyu40_id: int = column("NYU40 class, 0 when the label map has none", minimum=0, maximum=40)
    nyu40_label: str = column("NYU40 class name, 'unlabeled' for 0")
    found_by: str | None = column(
        "Who found the instance: file (the scan's files name it), geometry (of a scan that names none, or that names several as one), "
        "objects (of a finished dataset), synthesis (a model drew it), or the member of capture that found a small object which the scan "
        "does not name; missing in rows that are older than the column"
    )
    category_probability: float | None = column(
        "Of the category, as who found the instance says; missing where nobody guessed it", minimum=0, maximum=1
    )
    is_structure: bool = column("Wall, floor or ceiling: part of the room, never replaced by an asset")
    room_index: int | None = column(
        "Room in which the center of its box lies, else the nearest within half a metre (doors, windows); missing for structure, for what "
        "is farther from every room, and where nobody looked",
        minimum=0,
    )
    box_pose: tuple[float, ...] = column(
        "Oriented box to world frame, rotation about +Z, origin at the box center, 4x4 row by row", unit="m", length=16
    )
    box_size: tuple[float, ...] = column("Extents of the oriented box along its own axes", unit="m", length=3, minimum=0)
    box_volume_m3: float = column("Volume of the oriented box", unit="m3", minimum=0)
    hidden_m: tuple[float, ...] | None = column(
        "How far the object reaches beyond its box on the sides -x, +x, -y, +y, -z, +z where the scan could not see it: down to what "
        "it stands on, back to its wall; missing where nobody looked",
        unit="m",
        length=6,
        minimum=0,
    )
    point_count: int = column("Points of the instance", minimum=1)
    points_blob: str = column("Points in the world frame, binary PLY: x y z float32 [m], red green blue uint8", blob=True)
    mesh_blob: str | None = column("The instance's faces cut from the scan mesh, world frame, GLB", blob=True)
    view_blob: str | None = column("Best view of the instance, JPEG crop", blob=True)
    best_frames: tuple[str, ...] = column("Frames that see the instance best, best first")


@record("masks", key=("scene_id", "frame_id", "instance_id"), stage="capture")
class Mask:
    """Where an instance is seen in one of its best frames."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    frame_id: str = column("Frame, zero-padded", pattern=r"[0-9]{6}")
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    found_by: str | None = column(
        "Who saw it there: surface (the scan's own surface, as the frame shows it), or who found the instance in the frames; missing in "
        "rows that are older than the column"
    )
    pixel_box: tuple[int, ...] = column("x0, y0, x1, y1 in the color image, x1 and y1 exclusive", unit="px", length=4, minimum=0)
    pixel_count: int = column("Pixels of the mask in the color image", unit="px", minimum=1)
    visible_share: float = column("Share of the instance's points inside the image that the depth test sees", minimum=0, maximum=1)
    score: float = column("View quality: visible fraction x square root of mask area x (1 - border contact)", minimum=0)
    run_lengths: tuple[int, ...] = column(
        "Mask inside pixel_box, row by row: lengths of alternating runs, the first outside the mask", unit="px", minimum=0
    )
