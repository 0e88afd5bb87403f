"""Contradictions between poses, depth unit, intrinsics and image sizes of a recording, with both sides named."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.consistency.hypotheses import USUAL, lens_hypotheses, pose_hypotheses, unit_hypotheses
from tasks.capture.consistency.reprojection import DepthSample, Hypothesis, PairAgreement, agreement, telling_pairs, views_of
from tasks.capture.reading import FrameSource

Array = NDArray[np.float64]

MIN_AGREEMENT = 0.6
"""Agreement from which on depth confirms a reading: right ones of real and generated recordings have 0.73 to 0.94."""

MIN_GAIN = 1.4
"""Factor on the agreement of the stated reading from which on another one is clearly better: wrong ones stay below 0.55."""

MIN_SHARED = 0.2
"""Least overlap of all pairs together, in images: 80 points of which a share says something."""

MAX_CONTRADICTION = 0.4
"""Agreement below which poses and depth contradict each other, if frames overlap by `MIN_OVERLAP`."""

MIN_OVERLAP = 1.0
"""Overlap of all pairs together, in images: pairs that share little show a part of two surfaces by chance."""

MIN_DEPTH_M, MAX_DEPTH_M = 0.1, 30.0
"""Median depth [m] of a room or a table: sensors see nothing nearer, and rooms are not wider."""

NEAR_M, FAR_M = 0.8, 2.5
"""Without poses: readings of a room are not all nearer or all farther [m]."""

CENTER = (0.3, 0.7)
"""Principal point of an image in its size: 0.45 to 0.55 for phones and sensors; 0.25 is that of images of half the size."""


@dataclasses.dataclass(frozen=True)
class Statements:
    """Origin of a recording's facts, as messages name it.

    poses, lens, scale: the file that states each, or the format that defines it. described: words about the poses, empty for the
    usual ones. is_open: nothing states a convention of poses, so that depth may choose one. has_quaternions: poses are written as
    quaternions. from_file: axes of the file to the scan frame, 4x4. has_mesh: the scan has a mesh, which no frame changes.
    """

    poses: str
    lens: str
    scale: str
    described: str = ""
    is_open: bool = False
    has_quaternions: bool = False
    from_file: Array | None = None
    has_mesh: bool = False


def settled(frames: Sequence[FrameSource], statements: Statements) -> tuple[tuple[FrameSource, ...], list[str]]:
    """Frames with the poses that their depth confirms, and notes.

    Poses change only where nothing states their convention. With a mesh, a contradiction is a note: frames then give views alone.

    Raises:
        InputError: two facts of the recording contradict each other, and it has no mesh.
    """
    usable = [frame for frame in frames if frame.depth is not None and frame.depth_size is not None]
    posed = [frame for frame in usable if frame.pose is not None]
    views = views_of(posed if len(posed) > 1 else usable)
    try:
        if not views:
            return _with_possible_lenses(frames, statements), []
        _check_unit(usable[0], views, statements)
        if len(posed) < 2 or len(views) < 2:
            return _with_possible_lenses(frames, statements), _unit_note(usable[0], views, statements)
        return _judged(frames, posed, views, statements)
    except InputError as error:
        if not statements.has_mesh:
            raise
        return tuple(frames), [f"{error}; the scan's mesh stays as it is"]


def _judged(
    frames: Sequence[FrameSource], posed: Sequence[FrameSource], views: Sequence[DepthSample], statements: Statements
) -> tuple[tuple[FrameSource, ...], list[str]]:
    """Frames and notes of a recording that has poses and depth; raises InputError."""
    stated = agreement(views)
    pairs = ~np.eye(len(views), dtype=bool)
    share = stated.share(pairs)
    notes: list[str] = []
    if problem := _lens_problem(posed[0]):
        # Depth that agrees confirms a lens, however odd: an image may be a crop.
        if share < MIN_AGREEMENT or stated.compared.sum() < MIN_OVERLAP:
            raise InputError(statements.lens, "intrinsics", problem, _RESIZE)
        notes.append(f"{statements.lens}: intrinsics: {problem}; depth of its frames agrees on {share:.0%}")
    poses = pose_hypotheses(statements.described, statements.has_quaternions, statements.from_file)
    median = float(np.median(np.concatenate([view.points[:, 2] for view in views])))
    places = np.array([frame.pose[:3, 3] for frame in posed if frame.pose is not None])
    extent_m = float(np.ptp(places, axis=0).max())
    units = unit_hypotheses(posed[0].depth_scale, MAX_DEPTH_M / median, extent_m)
    lenses = lens_hypotheses(posed[0])
    judgments = [_judge(views, stated, hypothesis) for hypothesis in (*poses, *units, *lenses)]
    better = max((judgment for judgment in judgments if judgment.is_better), key=lambda judgment: judgment.share, default=None)
    if better is None:
        if share < MAX_CONTRADICTION and stated.compared.sum() >= MIN_OVERLAP:
            problem = f"frames that look at the same place agree on {share:.0%} of its depth, under no known reading of poses on more"
            notes.append(f"{statements.poses}: poses: {problem}; check their order, depth_scale and intrinsics, or refine the poses")
        return tuple(frames), notes
    sides = f"on {better.share:.0%} of what frames see in common, otherwise on {better.stated_share:.0%}"
    words = better.hypothesis.words
    if better.hypothesis in units:
        problem = f"{posed[0].depth_scale:g} units per meter and the poses of {statements.poses} contradict each other"
        detail = f"{problem}: with {words} depth agrees {sides}"
        raise InputError(statements.scale, "depth_scale", detail, "correct depth_scale in intrinsics.json, or the unit of the poses")
    if better.hypothesis in lenses:
        problem = f"fx {posed[0].depth_intrinsics[0]:.1f} for depth images {_size_of(posed[0])} and the poses contradict each other"
        raise InputError(statements.lens, "intrinsics", f"{problem}: with {words} depth agrees {sides}", _RESIZE)
    if statements.is_open:
        settled_frames = tuple(
            frame if frame.pose is None else dataclasses.replace(frame, pose=better.hypothesis.pose(frame.pose)) for frame in frames
        )
        line = f"poses read as {words}: depth of frames that see the same place then agrees {sides}"
        return settled_frames, [*notes, f"{line}; state pose_format in intrinsics.json to settle it"]
    stated_words = statements.described or USUAL
    problem = f"depth and poses that are stated as {stated_words!r:.60} contradict each other: as {words} depth agrees {sides}"
    raise InputError(statements.poses, "poses", problem, "correct the poses, or pose_format in intrinsics.json if it is wrong")


_RESIZE = "write intrinsics for the size of the images, with width and height in intrinsics.json"


@dataclasses.dataclass(frozen=True)
class _Judgment:
    hypothesis: Hypothesis
    share: float
    stated_share: float
    is_better: bool


def _judge(views: Sequence[DepthSample], stated: PairAgreement, hypothesis: Hypothesis) -> _Judgment:
    """Comparison of another reading with the stated one, on the pairs of views for which they differ."""
    other = agreement(views, hypothesis)
    pairs = telling_pairs(views, stated, other)
    share, stated_share = other.share(pairs), stated.share(pairs)
    is_enough = float(other.compared[pairs].sum()) >= MIN_SHARED
    confirms_more = float(other.confirmed[pairs].sum()) >= MIN_GAIN * float(stated.confirmed[pairs].sum())
    is_better = is_enough and confirms_more and share >= max(MIN_AGREEMENT, MIN_GAIN * stated_share)
    return _Judgment(hypothesis, share, stated_share, is_better)


def _with_possible_lenses(frames: Sequence[FrameSource], statements: Statements) -> tuple[FrameSource, ...]:
    """The frames as they are; raises InputError if a lens cannot be that of its images."""
    for frame in frames[:1]:
        if problem := _lens_problem(frame):
            raise InputError(statements.lens, "intrinsics", problem, _RESIZE)
    return tuple(frames)


def _lens_problem(frame: FrameSource) -> str:
    """Contradiction between intrinsics and image sizes of a frame, empty without one."""
    both = [("color", frame.intrinsics, (frame.width, frame.height))]
    both += [("depth", frame.depth_intrinsics, frame.depth_size)] if frame.depth_size is not None else []
    for kind, (_, _, cx, cy), (width, height) in both:
        own = f"its principal point ({cx:.1f}, {cy:.1f}) is that of images of about {2 * cx + 1:.0f} x {2 * cy + 1:.0f} pixels"
        sides = f"{own}, and the {kind} images have {width} x {height}"
        if not all(CENTER[0] * size <= center <= CENTER[1] * size for center, size in ((cx, width), (cy, height))):
            return sides
        off, turned_off = _off_center(cx, cy, width, height), _off_center(cx, cy, height, width)
        if turned_off < 0.1 < 0.15 < off:
            return f"{sides}: turned by 90 degrees"
    return ""


def _off_center(cx: float, cy: float, width: int, height: int) -> float:
    """Distance of a principal point from the middle of an image, in image sizes."""
    return max(abs((cx + 0.5) / width - 0.5), abs((cy + 0.5) / height - 0.5)) * 2


def _check_unit(frame: FrameSource, views: Sequence[DepthSample], statements: Statements) -> None:
    """Raise InputError if depth cannot have its unit."""
    median = float(np.median(np.concatenate([view.points[:, 2] for view in views])))
    if not MIN_DEPTH_M <= median <= MAX_DEPTH_M:
        problem = f"{frame.depth_scale:g} units per meter put half of the readings of {frame.depth_file} and others at {median:.3g} m"
        raise InputError(statements.scale, "depth_scale", problem, f"state the units per meter in intrinsics.json: {_LISTED}")


_LISTED = "1000 for millimeters, 5000 for TUM, 1 for meters"


def _unit_note(frame: FrameSource, views: Sequence[DepthSample], statements: Statements) -> list[str]:
    """A line on depth whose unit is doubtful, which nothing but its readings can tell without two poses."""
    low, high = np.quantile(np.concatenate([view.points[:, 2] for view in views]), [0.05, 0.95])
    is_doubtful = (high < NEAR_M and frame.depth_scale > 1000.0) or (low > FAR_M and frame.depth_scale <= 1000.0)
    line = f"at {frame.depth_scale:g} units per meter, depth is {low:.2f} to {high:.2f} m: unusual for a room"
    return [f"{statements.scale}: depth_scale: {line}; check it: {_LISTED}"] if is_doubtful else []


def _size_of(frame: FrameSource) -> str:
    assert frame.depth_size is not None
    return f"of {frame.depth_size[0]} x {frame.depth_size[1]} pixels"
