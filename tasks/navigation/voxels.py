"""Settings of the baking of navmeshes."""

from __future__ import annotations

import dataclasses
from typing import Annotated

from pydantic import Field

from tasks.settings import Config, NonNegative, Positive


@dataclasses.dataclass(frozen=True)
class Voxels(Config):
    """How a navmesh is baked. Lengths are habitat-sim's own: habitat-lab asks for them, and any other makes it bake anew, silently."""

    cell_size_m: Positive = 0.05  # habitat-sim's default; walls and furniture grow by the agent's radius, rounded up to cells
    cell_height_m: Positive = 0.2  # habitat-sim's default, and the agent's climb: one layer of voxels is climbed
    max_slope_degrees: Annotated[float, Field(ge=0, lt=90)] = 45.0  # habitat-sim's default
    region_min_cells: NonNegative = 20.0  # habitat-sim's default: parts of less than 20 x 20 cells (1 m2) are dropped
    region_merge_cells: NonNegative = 20.0  # habitat-sim's default
    edge_max_length_m: Positive = 12.0  # habitat-sim's default: longer outlines are cut, which no room's is
    edge_max_error_cells: NonNegative = 1.3  # habitat-sim's default: an outline may cut corners by 6.5 cm
    detail_sample_cells: NonNegative = 6.0  # habitat-sim's default; heights only
    detail_max_error_cells: NonNegative = 1.0  # habitat-sim's default; heights only
