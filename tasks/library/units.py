"""In which units a model is, which of its axes points up and which shows its front: by its file, by metadata, or by what is plausible."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.captions.physics import known_name
from tasks.furniture import is_known, typical_extents
from tasks.geometry.meshes import canonical
from tasks.geometry.transforms import Y_UP_TO_Z_UP, Z_UP_TO_Y_UP, yaw_pose
from tasks.library.format import Axis, ReadModel
from tasks.library.metadata import ModelFacts

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Known = Literal["file", "metadata", "plausibility", "assumed"]
"""How something is known: the file or its format states it, metadata beside it do, it follows from the usual size of the category, or
nothing tells and the most usual is taken."""

ALIKE = 0.15
"""Logarithm of a ratio: sides that metadata state agree with those of the file when they are this near to a common unit."""

CLEARER = 0.5
"""So much nearer to the usual sides, as a sum of logarithms, another axis has to bring a model that says nothing of its up."""

UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "hundreds of metres": 100.0, "kilometres": 1000.0}
"""What files are written in, although GLB is in metres, and how many metres [m] that is."""

ABSURD = 4.0
"""So many times as large or small as is usual for its category, a model is odd: a toy chair is a third of a chair."""

OTHER_UNITS = 15.0
"""So many times as large or small it is in other units: boxes differ by ten."""

PLAUSIBLE = 2.0
"""So near to the usual size a unit has to bring it."""

AXES = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}


@dataclasses.dataclass(frozen=True)
class Convention:
    """Units and axes of a file. unit_m: Metres per unit [m]. up: Its axis that points up. front: Its axis that shows the front, '' where
    nobody says. note: What is odd about its size, ''."""

    unit_m: float
    unit_known: Known
    up: Axis
    up_known: Known
    front: str
    front_known: Known
    note: str = ""


def convention_of(model: ReadModel, facts: ModelFacts, category: str) -> Convention:
    """Units and axes of a model. What metadata state outright comes before the file; sizes that they state are held against it."""
    extents = _extents(model.parts)
    up: Axis = facts.up or model.up or _plausible_up(extents, category) or "y"
    if facts.up:
        up_known: Known = "metadata"
    elif model.up:
        up_known = "file"
    else:
        up_known = "plausibility" if _plausible_up(extents, category) else "assumed"
    unit, unit_known, note = _unit(model, facts, category, extents)
    front = facts.front if facts.front in AXES and facts.front[1:] != up else ""
    return Convention(unit, unit_known, up, up_known, front, "metadata" if front else "assumed", note)


def canonical_parts(model: ReadModel, convention: Convention) -> list[trimesh.Trimesh]:
    """Parts of a model in metres, +Z up, front +X where it is known, origin at the bottom center of the box."""
    turn = np.eye(4)
    if model.is_turned and convention.up == "z":
        turn = Z_UP_TO_Y_UP
    elif not model.is_turned and convention.up == "y":
        turn = Y_UP_TO_Z_UP
    if convention.front:
        from_file = Y_UP_TO_Z_UP if convention.up == "y" else np.eye(4)
        x, y, _ = from_file[:3, :3] @ np.array(AXES[convention.front], dtype=np.float64)
        turn = yaw_pose(-float(np.arctan2(y, x))) @ turn
    parts = []
    for part in model.parts:
        moved = part.copy()
        moved.apply_transform(np.diag([convention.unit_m] * 3 + [1.0]) @ turn)
        parts.append(moved)
    return canonical(parts)


def _unit(model: ReadModel, facts: ModelFacts, category: str, extents: Array) -> tuple[float, Known, str]:
    """Metres per unit, how that is known, and what is odd about the size."""
    if facts.unit_m is not None:
        return facts.unit_m, "metadata", usual_scale(category, extents * facts.unit_m)[1].partition(":")[0]
    measured = unit_of_sizes(extents, facts.extents_m) if facts.extents_m is not None else None
    if measured is not None:
        return measured, "metadata", ""
    stated = model.unit_m if model.unit_m is not None else 1.0
    scale, odd = usual_scale(category, extents * stated)
    if scale != 1.0:
        return stated * scale, "plausibility", odd
    return stated, "file" if model.unit_m is not None else "assumed", odd


def usual_scale(category: str, extents: ArrayLike) -> tuple[float, str]:
    """Metres per unit of a file that holds a model of a category, of `extents` in its units, shape (3,), and what is odd about its size.

    1 and '' where nothing is, or nobody knows how large such a thing usually is; 1 and a text where no unit explains the size.
    """
    name = next((name for name in (category, known_name(category) or "") if is_known(name)), None)
    size = float(np.linalg.norm(np.asarray(extents, dtype=np.float64)))
    if name is None or not np.isfinite(size) or size <= 0.0:
        return 1.0, ""
    ratio = size / float(np.linalg.norm(typical_extents(name)))
    if 1.0 / ABSURD <= ratio <= ABSURD:
        return 1.0, ""
    times = f"{ratio:.3g} times as large as a {name} usually is"
    unit = min(UNITS, key=lambda u: abs(np.log(ratio * UNITS[u])))
    if abs(np.log(ratio)) < np.log(OTHER_UNITS) or abs(np.log(ratio * UNITS[unit])) > np.log(PLAUSIBLE):
        return 1.0, f"is {times}: used as it is"
    return UNITS[unit], f"would be {times}: read as {unit}"


def unit_of_sizes(extents: ArrayLike, extents_m: ArrayLike) -> float | None:
    """Metres per unit by which extents, shape (3,), become stated ones [m], in whatever order of axes; None where no unit does."""
    mine, stated = np.sort(np.asarray(extents, dtype=np.float64)), np.sort(np.asarray(extents_m, dtype=np.float64))
    if not (mine[1] > 0 and stated[1] > 0 and np.isfinite(mine).all() and np.isfinite(stated).all()):
        return None
    ratio = np.log(stated[1:] / mine[1:])  # the thinnest side of flat things is measured badly
    return float(np.exp(ratio.mean())) if np.ptp(ratio) <= ALIKE else None


def _plausible_up(extents: Array, category: str) -> Axis | None:
    """The axis whose direction makes a model as high as its category usually is; None where neither is clearer."""
    name = next((name for name in (category, known_name(category) or "") if name and is_known(name)), None)
    if name is None or not (extents > 0).all():
        return None
    usual = np.array(typical_extents(name))

    def odd(height: float, sides: Array) -> float:
        shape = np.array([*np.sort(sides), height])
        wanted = np.array([*np.sort(usual[:2]), usual[2]])
        ratio = np.log(shape / wanted)
        return float(np.abs(ratio - ratio.mean()).sum())  # whatever the unit

    y_up, z_up = odd(extents[1], extents[[0, 2]]), odd(extents[2], extents[:2])
    if abs(y_up - z_up) < CLEARER:
        return None
    return "y" if y_up < z_up else "z"


def _extents(parts: list[trimesh.Trimesh]) -> Array:
    """Sides of the box around parts along their own axes, shape (3,)."""
    bounds = np.array([part.bounds for part in parts if len(part.vertices)])
    return np.asarray(bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0), dtype=np.float64)
