"""Settings of the alignment."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from tasks.alignment.methods import METHODS
from tasks.settings import Config, Whole, union_of

if TYPE_CHECKING:
    from tasks.alignment.method import AlignmentMethodConfig as Method
else:
    Method = union_of(method.config for method in METHODS)


@dataclasses.dataclass(frozen=True)
class AlignmentConfig(Config):
    """How the pose of an asset on an instance is searched. What stands beside `method` are settings of the first and of measures that all
    share."""

    method: Method = dataclasses.field(default_factory=METHODS[0].config)  # least errors of yaw and surface (docs/alignment.md)
    yaw_count: Whole = 24  # every 15 degrees: half a step is within reach of the refinement; a multiple of 4 holds the box's own yaws
    hopeless: float = 1.5  # a yaw that costs this many times the best one's stays behind after refinement too
    starts: Whole = 3  # a chair fits nearly as well turned by 90 or 180 degrees: the best three are refined, then compared
    refine_steps: Whole = 12  # nearest-point refinement of one yaw and two shifts settles within ten
    refine_share: float = 0.8  # the farthest fifth of the points is noise or bleeding from neighbors
    refine_yaw_radians: float = 0.2  # a little more than half a yaw step
    rebox_yaw_radians: float = 0.03  # turned by more, the box was askew and its sides were not the object's: a 2 m desk gains 6 cm
    refine_shift: float = 0.1  # of the box's side: the box is known to a tenth even where the scan is thin
    smallest_scale: float = 0.5  # beyond half or twice its size an asset depicts another object (a coffee table is no desk)
    largest_scale: float = 2.0  # twice its size, as smallest_scale
    anisotropy: float = 1.6  # the largest over the smallest scale: beyond it round objects turn visibly oval
    thin_m: float = 0.03  # scan noise across a thin side: such a side says little about scale
    points: Whole = 512  # scanned points: 3 cm apart on a chair, 8 cm on a bed
    samples: Whole = 1024  # of the asset's whole surface, of which the scan saw half or less
    coarse: Whole = 224  # of both, for the yaw search: the cost separates yaws long before it is exact
    refine_points: Whole = 256  # for refining and comparing poses of one asset: errors of single nearest points average out
    refine_samples: Whole = 512  # of the surface, twice refine_points: the scan saw half of it or less
    settle: float = 0.01  # a refined pose must be better by this share than the pose squared up with the box
    own_size: float = 0.2  # a model of a library that explains the points keeps its size unless a fitted scale costs less by this share
    hidden_weight: float = 0.1  # undersides are never seen; a little weight keeps a solid block from posing as a table
    hidden_normal: float = -0.5  # z of a normal that counts as an underside: steeper than 30 degrees below the horizon
    seen_share: float = 0.75  # one side against a wall is up to a quarter of the surface: the worst quarter does not count
    truncation: float = 0.2  # of the diagonal: farther is wrong, however far
