"""What the frames of a scan show of its objects, for twins: read from where the scan is, since raw frames are not in the lake."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from schemas.capture import Frame, Instance
from schemas.errors import InputError
from tasks.capture.leveling import read_scan
from tasks.capture.scan import Scan
from tasks.geometry.meshes import read_points
from tasks.texturing.views import ColorView, ViewsConfig, best_views, views_of

NO_SCAN = "the scan is not at hand, and with it its frames"


def sightings(
    scan: Scan | None, frames: Sequence[Frame], objects: Sequence[Instance], blobs: Mapping[str, bytes], config: ViewsConfig
) -> tuple[dict[str, tuple[ColorView, ...]], str, list[str]]:
    """The views that show each object best, by instance, with poses as the lake has them; why there are none, '' where there are some; and
    what could not be read. scan: None where a run has none.

    Raises:
        ConnectionError: a scan that a run has is not there any more, or not on this machine: the next run goes on.
        OSError: its store is away.
    """
    poses = {frame.frame_id: frame.pose for frame in frames if frame.pose is not None}
    if not poses:
        return {}, "the scan has no frames with a pose", []
    if scan is None:
        return {}, NO_SCAN, []
    if not scan.path.exists():
        raise ConnectionError(f"{scan.path}: was there when the run was planned; twins need its frames")
    try:
        views = views_of(read_scan(scan).frames, poses)
    except InputError as error:
        return {}, f"{NO_SCAN}: {error}"[:300], []
    if not any(view.depth is not None for view in views):
        return {}, "frames without depth images do not say what stands before an object", []
    points, problems = {}, []
    for row in objects:
        try:
            points[row.instance_id] = read_points(blobs[row.points_blob], row.points_blob)[0]
        except (InputError, KeyError) as error:
            problems.append(f"{row.instance_id}: {error}")
    best, unread = best_views(views, points, config)
    return best, "", [*problems, *unread]
