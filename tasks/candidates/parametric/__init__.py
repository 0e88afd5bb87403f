"""Candidates fitted to an instance's points: templates of furniture whose parameters are found by analysis and synthesis.

A sofa round a bend, a desk with a return, a shelf with as many boards as the scan shows, a worktop with its cut-out, legs that the scan
lost. Templates are drawn from blocks; where none fits, nothing is offered.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from tasks.candidates.assets import MadeAsset, make_asset
from tasks.candidates.parametric.building import built
from tasks.candidates.parametric.forms import forms_of, kind_of
from tasks.candidates.provider import CandidateProvider, NothingToOffer
from tasks.candidates.scan_crop import is_stand_in
from tasks.settings import Config, Count, Positive, Share

if TYPE_CHECKING:
    from tasks.candidates.parametric.fitting import ParametricFit
    from tasks.candidates.request import CandidateRequest

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Parametric(Config):
    """A template of furniture, its parameters fitted to the instance's points."""

    kind: ClassVar[str] = "parametric"
    min_points: Count = 150  # fewer fit any form
    points: Count = 500  # that forms are held against: 4 cm apart on a chair, 8 cm on a corner sofa
    near_m: Positive = 0.05  # a point this near to the surface is covered; less on what is small
    near_share: Positive = 0.05  # of the diagonal, as for near_m
    covered: Share = 0.68  # of the points: less, and it is another form; a fifth is often pillows, cloths and neighbors
    outside_m: Positive = 0.035  # mean distance of the points, of which those far off count 0.15: points that fill a box are 0.054 off
    bare: Share = 0.42  # of the surface that should be seen: more without points, and the form fills what is empty
    version: str = "2"  # goes up when the same points would get another asset


def parametric_asset(request: CandidateRequest, provider: Parametric) -> MadeAsset:
    """The fitted template of an instance; raises as `fit_of` does."""
    kind, fit, points, colors = fit_of(request, provider)
    parts, pieces = built(fit.blocks, turned_back(points, fit.turn), colors, request.color)
    return make_asset(
        parts, provider=provider.kind, name=f"{fit.template.name} {kind}", category=kind, source="parametric templates",
        license="CC0-1.0", pieces=pieces,
    )  # fmt: skip


def fit_of(request: CandidateRequest, provider: Parametric) -> tuple[str, ParametricFit, Array, NDArray[np.uint8]]:
    """The category of an instance's template and how it fits, and the points that it was held against, in the frame of the box, z from its
    bottom [m], with their colors: shapes (n, 3).

    Raises:
        NothingToOffer: the category has no template, the scan has a plain box instead of the furniture, there are too few points, or no
            template fits them.
    """
    from tasks.candidates.parametric.distances import fit_target
    from tasks.candidates.parametric.fitting import fitted_template

    kind = kind_of(request)
    if kind is None:
        raise NothingToOffer(f"no template of a {request.category}")
    if request.instance.mesh_blob is not None and is_stand_in(request.crop, request.category):
        # Panels on all sides would fit a box best, and fill the space that chairs are tucked into.
        raise NothingToOffer(f"the scan has the box of the {request.category} alone, to which no template can be fitted")
    points, colors = request.points
    size = np.array(request.extents)
    within = (np.abs(points) <= 0.5 * size + provider.near_m).all(axis=1)
    points, colors = points[within] + np.array([0.0, 0.0, 0.5 * size[2]]), colors[within]
    if len(points) < provider.min_points:
        raise NothingToOffer(f"{len(points)} points are too few to fit a {kind}")
    near = min(provider.near_m, provider.near_share * float(np.linalg.norm(size)))
    unseen = np.array(request.instance.hidden_m or (0.0,) * 6) > 0.0
    target = fit_target(points, size, unseen, near, provider.points)
    fit = fitted_template(target, forms_of(kind, request, points))
    if fit is None:
        raise NothingToOffer(f"no template of a {kind} has its proportions, or too little of it was seen")
    if fit.covered < provider.covered or fit.outside > provider.outside_m or fit.bare > provider.bare:
        raise NothingToOffer(
            f"no {kind} fits: the best, {fit.template.name}, covers {fit.covered:.0%} of the points, {1000 * fit.outside:.0f} mm off, "
            f"{fit.bare:.0%} of it bare"
        )
    return kind, fit, points, colors


def turned_back(points: Array, turn: int) -> Array:
    """Points, shape (n, 3), in the frame of a form that is turned by quarters about +Z."""
    x, y, z = points.T
    for _ in range(turn % 4):
        x, y = y, -x
    return np.column_stack([x, y, z])


PARAMETRIC = CandidateProvider(name="parametric", config=Parametric, offer=parametric_asset)
