"""Poses by Open3D, in a process of its own: odometry from frame to frame, loops closed, and the whole relaxed."""

from __future__ import annotations

import dataclasses
import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from schemas.errors import InputError
from schemas.files import read_file
from schemas.machine.scratch import temporary_folder
from schemas.parsing import json_value
from tasks.calls.command import run_apart
from tasks.capture.reading import FrameSource
from tasks.capture.small_objects.lifting import depth_view
from tasks.geometry.transforms import is_rigid
from tasks.settings import LISTED, Config, Count, Natural, Positive, Share

Array = NDArray[np.float64]

SCRIPT = Path(__file__).with_name("open3d_script.py")

FIELD = "capture.poses.provider.python"

Pixels = Annotated[int, Field(ge=80)]


Voxels = Annotated[tuple[Positive, ...], LISTED]


@dataclasses.dataclass(frozen=True)
class FoundPoses:
    """Poses that were found from color and depth.

    poses: camera to the frame of the first, shape (n, 4, 4) [m], NaN where nothing joins a frame to the others. line: how they came
    about. keys, loops: key frames of the graph, and closed loops between them that were kept.
    """

    poses: Array
    line: str
    keys: int
    loops: int


@dataclasses.dataclass(frozen=True)
class Open3DPoses(Config):
    """Found from color and depth by Open3D; poses that a scan has are where it starts, and are kept where they fit the depth.

    Frames have to follow one another as a camera moves: neighbors that show nothing in common are found by features of their surfaces,
    which succeeds for some.
    """

    kind: ClassVar[str] = "open3d"
    python: str = ""  # an interpreter that has open3d; without one the interpreter of this process, where `make open3d` puts it
    always: bool = False  # refine poses that fit, too: a tracker's own are better than they look where little depth is in reach
    max_frames: Count = 1500  # evenly over all: 50 seconds of video, half a minute to ten minutes of a core
    width_px: Pixels = 320  # wider images are thinned: odometry looks at pyramids of them, and depth has no finer detail
    max_depth_m: Positive = 4.0  # noise beyond pulls registrations off
    voxels_m: Voxels = (0.08, 0.04, 0.025)  # of registrations, coarse to fine: drift of 10 cm comes into reach
    sure_score: Share = 0.75  # share of a frame that the next one confirms, from which on no further guess is tried
    least_score: Share = 0.2  # below it, a frame does not follow from the one before
    least_agreement: Share = 0.6  # of what two frames share, for a motion that only features give
    key_m: Positive = 0.3  # a node of the graph for so much of the way ...
    key_radians: Positive = 0.3  # ... or of turning: neighbors then share two thirds of what they see
    least_overlap: Share = 0.35  # of what a frame sees, for it to be held against a far one
    loops_per_frame: Count = 3  # more say the same again
    loop_agreement: Share = 0.7  # of what two frames share: less is two surfaces that look alike
    rounds: Count = 2  # of closing loops and relaxing: the first brings frames into each other's reach
    least_points: Count = 100  # of a frame at the coarsest voxel: fewer show nothing to register
    timeout_s: Positive = 3600.0  # of the whole; it takes a tenth of a second to a second for a frame
    seed: Natural = 0  # of what is tried by chance

    def problem(self) -> str:
        """Why Open3D cannot be run here, '' where it can."""
        python = shutil.which(self.python or sys.executable)
        if python is None:
            return "no such program"
        with temporary_folder() as folder:
            try:
                return run_apart([python, "-I", "-c", "import open3d"], folder, self.timeout_s).problem
            except (OSError, ValueError) as error:
                return str(error)

    def poses_of(self, frames: Sequence[FrameSource], given: Array) -> FoundPoses:
        """Poses of frames that have depth. given: poses to start from, NaN where there is none, shape (n, 4, 4) [m].

        Raises:
            InputError: Open3D cannot be run, or did not do its work; or an image cannot be read.
        """
        remedy = "run `make open3d` once, or name an interpreter that has open3d-cpu"
        python = shutil.which(self.python or sys.executable)
        if python is None:
            raise InputError(self.python, FIELD, "is no program that can be run", remedy)
        with temporary_folder() as folder:
            shape = _written(folder, frames, self.width_px)
            np.asarray(given, dtype="<f8").tofile(folder / "given.f8")
            settings = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name not in _NOT_OF_THE_SCRIPT}
            (folder / "settings.json").write_text(json.dumps({**settings, "shape": shape}))
            # sums of several threads have no order, and poses no last digits that stay
            command = [str(Path(python).absolute()), "-I", str(SCRIPT.resolve()), str(folder)]
            try:
                ending = run_apart(command, folder, self.timeout_s, {"OMP_NUM_THREADS": "1"})
            except (OSError, ValueError) as error:
                raise InputError(python, FIELD, f"cannot be run: {error}", remedy) from error
            if ending.problem:
                raise InputError(
                    python, FIELD, f"Open3D {ending.problem}", remedy if ending.code else "raise timeout_s, or lower max_frames"
                )
            size = 128 * len(frames)
            content = read_file(folder / "poses.f8", "poses.f8 of Open3D", size, remedy)
            summary = json_value(read_file(folder / "said.json", "said.json of Open3D", 10_000, remedy))
        if len(content) != size:
            raise InputError(python, FIELD, f"left {len(content)} bytes for {len(frames)} poses", remedy)
        poses = np.frombuffer(content, dtype="<f8").reshape(-1, 4, 4).copy()
        for pose in poses:
            if not is_rigid(pose, 1e-6):
                pose[:] = np.nan
        steps, loops = (
            f"{summary['steps']} steps between {summary['keys']} key frames",
            f"{summary['kept']} of {summary['loops']} closed loops kept",
        )
        return FoundPoses(poses, f"Open3D {summary['version']}: {steps}, {loops}", int(summary["keys"]), int(summary["kept"]))


_NOT_OF_THE_SCRIPT = ("python", "always", "max_frames", "width_px", "timeout_s")


def _written(folder: Path, frames: Sequence[FrameSource], width: int) -> tuple[int, int, int]:
    """Images of frames as the script reads them, thinned to at most so many columns; how many, and their height and width [px]."""
    sizes = [frame.depth_size for frame in frames if frame.depth_size is not None]
    step = max(1, -(-max(columns for columns, _ in sizes) // width))
    height, width = (-(-max(size[axis] for size in sizes) // step) for axis in (1, 0))
    intrinsics = np.zeros((len(frames), 4))
    with (folder / "color.u1").open("wb") as color_file, (folder / "depth.f4").open("wb") as depth_file:
        for index, frame in enumerate(frames):
            view = depth_view(dataclasses.replace(frame, pose=np.eye(4)), np.eye(4))
            assert view is not None
            color, depth = np.zeros((height, width, 3), dtype=np.uint8), np.zeros((height, width), dtype="<f4")
            thin = view.depth[::step, ::step]
            color[: len(thin), : thin.shape[1]] = view.color[::step, ::step]
            depth[: len(thin), : thin.shape[1]] = thin
            color.tofile(color_file)
            depth.tofile(depth_file)
            intrinsics[index] = np.array(frame.depth_intrinsics) / step  # pixel centers are at whole numbers, the first one stays
    intrinsics.astype("<f8").tofile(folder / "intrinsics.f8")
    return len(frames), height, width
