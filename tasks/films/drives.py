"""Films and plans of carts: the room with the cart at a slant from above, and beside it where it is and where it believes to be."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.robot import RobotRun
from tasks.films.frames import GAP_PX, INK, MUTED, OUTCOMES, PAPER, lettering
from tasks.films.third_person import START, TARGET, TRACK, ThirdPerson
from tasks.films.walks import FilmLook
from tasks.policy.model.config import AgentCamera

if TYPE_CHECKING:
    import shapely
    from PIL import Image, ImageDraw

ESTIMATE, WAY, SUBGOAL = (226, 120, 20), (150, 160, 172), (30, 140, 90)
"""Colors of where the cart believes to be, of the policy's way and of sub-goals, RGB."""

FLOOR, OBSTACLE, EDGE = (243, 239, 230), (176, 161, 143), (93, 83, 72)
"""Colors of the floor, of what stands on it, and of outlines, RGB."""

MOST_FRAMES = 90
"""Of a film: fifteen seconds."""

_FINER = 3
"""Lines are drawn so many times larger, and made smaller for smooth edges."""

_MARGIN_PX = 14


@dataclasses.dataclass(frozen=True)
class FilmedRun:
    """A run to film. way: Positions of the policy's way, world frame [m], shape (n, 2). height_m: Of the cart."""

    run: RobotRun
    way: NDArray[np.float64]
    height_m: float
    camera: AgentCamera = dataclasses.field(default_factory=AgentCamera)

    @property
    def steps(self) -> list[int]:
        """Numbers of the recorded poses that become frames: evenly spread, the first and the last among them."""
        count = min(len(self.run.track), MOST_FRAMES)
        return sorted({round(index * (len(self.run.track) - 1) / max(count - 1, 1)) for index in range(count)})

    @property
    def poses(self) -> NDArray[np.float64]:
        """True poses of the frames, x, y [m] and yaw [rad], world frame, shape (n, 3)."""
        return np.array(self.run.track, dtype=np.float64).reshape(-1, 3)[self.steps]

    @property
    def target(self) -> str:
        """The episode's instance."""
        return self.run.instance_id

    @property
    def radius_m(self) -> float:
        """Of the cart."""
        return self.run.radius_m

    @property
    def ending(self) -> str:
        """How it ended, for people."""
        run = self.run
        how = f"arrived after {run.seconds:.0f} s" if run.outcome == "arrived" else f"{run.outcome}: {run.problem}"
        moved = f", {len(run.moved)} things moved" if run.moved else ""
        return f"{how}{moved}; knew where it was to {100 * run.error_m:.1f} cm, wheels alone to {100 * run.wheels_error_m:.0f} cm"


class DrivePlan:
    """The plan of a run: floor, what stands on it, the policy's way, sub-goals, track and estimate.

    Args:
        filmed: The run.
        floor: The floor polygon, world frame [m].
        obstacles: Outlines of what the cart could run into, as its map has them [m].
        size: Width and height [px].
    """

    def __init__(self, filmed: FilmedRun, floor: shapely.Geometry, obstacles: Sequence[shapely.Geometry], size: tuple[int, int]) -> None:
        from PIL import Image, ImageDraw

        self._filmed, self._size = filmed, size
        low = np.array(floor.bounds[:2])
        extent = np.array(floor.bounds[2:]) - low
        inner = np.array(size) - 2 * _MARGIN_PX
        self._scale = float((inner / np.maximum(extent, 1e-6)).min()) * _FINER
        offset = (np.array(size) * _FINER - extent * self._scale) / 2
        self._origin = np.array([offset[0] - low[0] * self._scale, size[1] * _FINER - offset[1] + low[1] * self._scale])
        self._ground = Image.new("RGB", (size[0] * _FINER, size[1] * _FINER), PAPER)
        brush = ImageDraw.Draw(self._ground)
        self._fill(brush, floor, FLOOR)
        for outline in obstacles:
            self._fill(brush, outline, OBSTACLE)
        self._line(brush, filmed.way, WAY, 0.03)
        for point in filmed.run.subgoals:
            self._dot(brush, point, 0.05, SUBGOAL)

    def picture(self, step: int) -> NDArray[np.uint8]:
        """The plan with the cart at a recorded pose, by its number; shape (h, w, 3)."""
        from PIL import Image, ImageDraw

        run = self._filmed.run
        image = self._ground.copy()
        brush = ImageDraw.Draw(image)
        track, estimate = np.array(run.track), np.array(run.estimate)
        self._line(brush, track[: step + 1, :2], TRACK, 0.04)
        self._dot(brush, track[0], 0.09, START)
        if run.subgoals:
            self._ring(brush, run.subgoals[-1], 0.14, TARGET)
        x, y, yaw = track[step]
        self._dot(brush, (x, y), run.radius_m, TRACK)
        nose = np.array([x, y]) + 0.9 * run.radius_m * np.array([np.cos(yaw), np.sin(yaw)])
        self._line(brush, np.array([[x, y], nose]), PAPER, 0.05)
        self._ring(brush, estimate[step], run.radius_m + 0.02, ESTIMATE)
        return np.asarray(image.resize(self._size, Image.Resampling.LANCZOS))

    def _places(self, points: ArrayLike) -> list[tuple[float, float]]:
        """Pixels of points, world frame [m], shape (n, 2)."""
        at = np.asarray(points, dtype=np.float64).reshape(-1, 2) * [self._scale, -self._scale] + self._origin
        return [(float(column), float(row)) for column, row in at]

    def _fill(self, brush: ImageDraw.ImageDraw, shape: shapely.Geometry, color: tuple[int, int, int]) -> None:
        import shapely

        for part in shapely.get_parts(shape):
            if part.geom_type != "Polygon" or part.is_empty:
                continue
            brush.polygon(self._places(shapely.get_coordinates(part.exterior)), color, EDGE, _FINER)
            for hole in part.interiors:
                brush.polygon(self._places(shapely.get_coordinates(hole)), FLOOR, EDGE, _FINER)

    def _line(self, brush: ImageDraw.ImageDraw, points: ArrayLike, color: tuple[int, int, int], width: float) -> None:
        """A line as wide as `width` [m], two pixels at least."""
        places = self._places(points)
        if len(places) > 1:
            brush.line(places, color, max(round(width * self._scale), 2 * _FINER), joint="curve")

    def _dot(self, brush: ImageDraw.ImageDraw, point: ArrayLike, radius: float, color: tuple[int, int, int]) -> None:
        ((column, row),) = self._places(np.asarray(point)[:2])
        reach = max(radius * self._scale, 2 * _FINER)
        brush.ellipse((column - reach, row - reach, column + reach, row + reach), color)

    def _ring(self, brush: ImageDraw.ImageDraw, point: ArrayLike, radius: float, color: tuple[int, int, int]) -> None:
        ((column, row),) = self._places(np.asarray(point)[:2])
        reach = max(radius * self._scale, 3 * _FINER)
        brush.ellipse((column - reach, row - reach, column + reach, row + reach), None, color, 2 * _FINER)


@dataclasses.dataclass(frozen=True)
class DriveStill:
    """The end of a run, a JPEG, and what is to be said of it."""

    policy: str
    run_name: str
    setup: str
    outcome: str
    scene_id: str
    episode_id: str
    category: str
    ending: str
    picture: bytes

    @property
    def mark(self) -> str:
        """How the color of the outcome is called."""
        return outcome_color(self.outcome)


def drive_frames(third: ThirdPerson, plan: DrivePlan, filmed: FilmedRun, look: FilmLook) -> Iterator[NDArray[np.uint8]]:
    """A frame for every shown pose of a run, shape (h, w, 3) each."""
    for index, step in enumerate(filmed.steps):
        yield drive_frame(third.picture(index), plan.picture(step), filmed, step, look)


def drive_frame(room: NDArray[np.uint8], plan: NDArray[np.uint8], filmed: FilmedRun, step: int, look: FilmLook) -> NDArray[np.uint8]:
    """One pose of a run, by the number of its record: the room, the plan, and below them who goes where; shape (h, w, 3)."""
    from PIL import Image, ImageDraw

    run, line = filmed.run, round(1.5 * look.text_px)
    height = max(room.shape[0], plan.shape[0])
    canvas = Image.new("RGB", (room.shape[1] + GAP_PX + plan.shape[1], height + 2 * line + 12), PAPER)
    canvas.paste(Image.fromarray(room), (0, 0))
    canvas.paste(Image.fromarray(plan), (room.shape[1] + GAP_PX, 0))
    brush, plain, bold = ImageDraw.Draw(canvas), lettering(look.text_px), lettering(look.text_px, "-Bold")
    first, second = height + 6 + line / 2, height + 6 + 1.5 * line
    chip = brush.textlength(run.outcome, bold) + 20
    brush.rounded_rectangle((0, first - line / 2 + 1, chip, first + line / 2 - 1), 5, OUTCOMES[outcome_color(run.outcome)])
    brush.text((chip / 2, first), run.outcome, PAPER, bold, "mm")
    goal = f"drive to the {run.category}"
    brush.text((chip + 10, first), goal, INK, bold, "lm")
    brush.text((chip + 22 + brush.textlength(goal, bold), first), f"way of {run.policy}, {run.run_name}", INK, plain, "lm")
    brush.text((canvas.width, first), f"{run.times[step]:.1f} s", INK, bold, "rm")
    brush.text((0, second), f"{run.scene_id}, episode {run.episode_id}: {filmed.ending}", MUTED, plain, "lm")
    _legend(brush, canvas, second, look)
    return np.asarray(canvas)


def outcome_color(outcome: str) -> str:
    """How the color of an outcome is called."""
    return "success" if outcome == "arrived" else "failure"


LEGEND: Mapping[str, tuple[int, int, int]] = {"truth": TRACK, "estimate": ESTIMATE, "sub-goals": SUBGOAL, "way": WAY}
"""What the plan's colors say."""


def _legend(brush: ImageDraw.ImageDraw, canvas: Image.Image, row: float, look: FilmLook) -> None:
    """The plan's colors and their names, at the right."""
    right, font = float(canvas.width), lettering(look.text_px)
    for name, color in reversed(list(LEGEND.items())):
        brush.text((right, row), name, color, font, "rm")
        right -= brush.textlength(name, font) + 12
