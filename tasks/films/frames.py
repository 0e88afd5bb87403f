"""Frames of a film: the room with the agent, beside it what the agent sees, below them who goes where, and how it ends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.films.third_person import START, TARGET, ThirdPerson
from tasks.films.walks import FilmedWalk, FilmLook
from tasks.simulation.protocol import AgentView

if TYPE_CHECKING:
    from PIL import Image

INK, PAPER, MUTED = (28, 36, 48), (255, 255, 255), (86, 97, 112)
OUTCOMES = {"success": (47, 125, 85), "failure": (197, 48, 48)}
"""Colors of outcomes, RGB."""

GAP_PX = 8


def frames(third: ThirdPerson, views: Iterable[AgentView], walk: FilmedWalk, look: FilmLook) -> Iterator[NDArray[np.uint8]]:
    """A frame for every pose of a walk, shape (h, w, 3) each; `views` are what the agent saw from them."""
    for step, view in enumerate(views):
        yield frame(third, view, walk, step, look)


def frame(third: ThirdPerson, view: AgentView, walk: FilmedWalk, step: int, look: FilmLook) -> NDArray[np.uint8]:
    """One pose of a walk, by its number, shape (h, w, 3)."""
    from PIL import Image, ImageDraw

    width, height = look.room.width, look.room.height
    line = round(1.5 * look.text_px)
    left, top = view_place(look)
    canvas = Image.new("RGB", (width + GAP_PX + look.view_px, height + 2 * line + 12), PAPER)
    canvas.paste(room_picture(third, walk, step, look), (0, 0))
    canvas.paste(Image.fromarray(view.rgb), (left, top))
    below = top + view.rgb.shape[0] + line
    canvas.paste(Image.fromarray(depth_picture(view, int(walk.trajectory.instance_id), look.max_depth_m)), (left, below))
    brush, plain, bold = ImageDraw.Draw(canvas), lettering(look.text_px), lettering(look.text_px, "-Bold")
    brush.text((left, top - line / 2), "agent's camera", MUTED, plain, "lm")
    brush.text((left, below - line / 2), f"depth, 0 to {look.max_depth_m:g} m", MUTED, plain, "lm")
    row = walk.trajectory
    first, second = height + 6 + line / 2, height + 6 + 1.5 * line
    chip = brush.textlength(walk.outcome, bold) + 20
    brush.rounded_rectangle((0, first - line / 2 + 1, chip, first + line / 2 - 1), 5, OUTCOMES[walk.outcome])
    brush.text((chip / 2, first), walk.outcome, PAPER, bold, "mm")
    goal = f"go to the {row.category}"
    brush.text((chip + 10, first), goal, INK, bold, "lm")
    brush.text((chip + 22 + brush.textlength(goal, bold), first), f"policy {row.policy}, {row.run_name}", INK, plain, "lm")
    brush.text((canvas.width, first), walk.act(step), INK, bold, "rm")
    brush.text((0, second), f"{row.scene_id}, episode {row.episode_id}: {walk.ending}", MUTED, plain, "lm")
    return np.asarray(canvas)


def view_place(look: FilmLook) -> tuple[int, int]:
    """Where the upper left corner of what the agent sees is in a frame: column and row [px]."""
    return look.room.width + GAP_PX, round(1.5 * look.text_px)


def room_picture(third: ThirdPerson, walk: FilmedWalk, step: int, look: FilmLook) -> Image.Image:
    """The room with the agent at a pose, start and target with their names."""
    from PIL import Image

    image = Image.fromarray(third.picture(step))
    way = np.array([third.place((x, y, 0.0)) for x, y, _ in walk.poses])
    ahead = way[:8].mean(axis=0) - way[0]
    sides = np.array([(0.0, 1.7), (3.0, 0.0), (-3.0, 0.0)]) * look.text_px  # not above, where the agent's body is, and not on the way
    column, row = way[0] + sides[np.argmin(sides @ ahead / np.hypot(*sides.T))]
    _write(image, "start", (column, row), START, look.text_px)
    if third.target_box is not None:
        left, top, right, bottom = third.target_box
        above = top - look.text_px
        _write(image, walk.trajectory.category, ((left + right) / 2, above if above > look.text_px else bottom + look.text_px), TARGET,
               look.text_px)  # fmt: skip
    return image


def depth_picture(view: AgentView, target: int, most: float) -> NDArray[np.uint8]:
    """Depth as colors, near ones light, from 0 to `most` [m], gray where nothing is; a line around the target. Shape (h, w, 3)."""
    from matplotlib import colormaps
    from scipy.ndimage import binary_dilation

    share = np.clip(view.depth / most, 0, 1)
    colors = np.asarray(colormaps["YlGnBu"](share)[..., :3] * 255, dtype=np.uint8)
    colors[view.depth <= 0] = (200, 204, 210)
    is_target = view.semantic == target
    colors[binary_dilation(is_target, iterations=2) & ~is_target] = TARGET
    return colors


def stills(third: ThirdPerson, views: Iterable[AgentView], walk: FilmedWalk, look: FilmLook, count: int = 4) -> NDArray[np.uint8]:
    """A few poses of a walk side by side, the first and the last among them, each with what the agent sees; shape (h, w, 3)."""
    from PIL import Image, ImageDraw

    wanted = moments(len(walk.poses), count)
    seen = {step: view for step, view in enumerate(views) if step in wanted}
    line, width, height = round(1.6 * look.text_px), look.room.width, look.room.height
    below = max(view.rgb.shape[0] for view in seen.values())
    canvas = Image.new("RGB", (len(wanted) * (width + GAP_PX) - GAP_PX, line + height + GAP_PX // 2 + below), PAPER)
    brush, font = ImageDraw.Draw(canvas), lettering(look.text_px, "-Bold")
    for index, step in enumerate(wanted):
        left = index * (width + GAP_PX)
        brush.text((left, line / 2), walk.act(step), INK, font, "lm")
        canvas.paste(room_picture(third, walk, step, look), (left, line))
        view = seen[step]
        depth = depth_picture(view, int(walk.trajectory.instance_id), look.max_depth_m)
        for place, picture in ((left, view.rgb), (left + width - depth.shape[1], depth)):
            canvas.paste(Image.fromarray(picture), (place, line + height + GAP_PX // 2))
    return np.asarray(canvas)


def moments(poses: int, count: int) -> list[int]:
    """Numbers of at most `count` of so many poses, evenly spread, the first and the last among them."""
    return sorted({round(index * (poses - 1) / max(count - 1, 1)) for index in range(count)})


def _write(image: Image.Image, text: str, middle: tuple[float, float], color: tuple[int, int, int], size: int) -> None:
    """White letters on a colored plate, moved so that all of it is in the picture."""
    from PIL import ImageDraw

    brush, font = ImageDraw.Draw(image), lettering(size, "-Bold")
    half = brush.textlength(text, font) / 2 + 0.45 * size
    tall = 0.72 * size
    x = min(max(middle[0], half + 2), image.width - half - 2)
    y = min(max(middle[1], tall + 2), image.height - tall - 2)
    brush.rounded_rectangle((x - half, y - tall, x + half, y + tall), 0.35 * size, color)
    brush.text((x, y), text, PAPER, font, "mm")


@cache
def lettering(size: int, weight: str = "") -> Any:
    """The letters of the charts, as Pillow has them."""
    from pathlib import Path

    import matplotlib
    from PIL import ImageFont

    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"DejaVuSans{weight}.ttf"), size)
