"""What providers are asked with: an instance, its caption, its points, and what several slots share."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask
from schemas.errors import InputError
from tasks.alignment import AlignmentConfig, ScannedInstance, instance_frame
from tasks.candidates.assets import MadeAsset
from tasks.candidates.closing import SolidField, solid_field
from tasks.candidates.completion import Unseen
from tasks.candidates.provider import NothingToOffer, ProviderConfig
from tasks.candidates.retrieval import Retrieval
from tasks.candidates.scan_crop import BOX_FACES, crop_of, pieces_of_crop
from tasks.captions.colors import name_colors, word_rgb
from tasks.geometry.boxes import box_footprint, grown_box
from tasks.geometry.meshes import Surface, read_points
from tasks.geometry.transforms import inverse, transform_points, translation
from tasks.library.descriptors import Descriptor, describe
from tasks.library.search import LibraryMatch
from tasks.mounting import carried
from tasks.stage import Context
from tasks.texturing.views import ColorView
from tasks.views.crops import Crop
from tasks.views.crops import crop_of as crop_of_view
from tasks.views.fronts import has_lines
from tasks.views.sightlines import FREE_DISTANCE_M, DepthMap, is_seen_empty

if TYPE_CHECKING:
    import trimesh

NEAR_FLOOR_M = 0.1
"""What has no name and ends this near to the floor stands on it."""

ON_TOP_M = 0.05
"""What ends this near to the top of another stands on it."""

MIN_SIDE_M = 0.005
"""A model gets no side thinner than 5 mm, however flat the scanned box is: posters and rugs come out without thickness."""


NO_POINTS = "the points of the instance are not among the blobs"


@dataclasses.dataclass(frozen=True)
class CandidateRequest:
    """An instance to be stood in for, how the library is searched where one is given, and the scene's objects. frame, mask: Of its best
    view, as far as they are known. views: Frames that show it, and unseen, why there are none. sightlines: Depth maps of the scan.
    filled: Assets of slots that are filled already, by slot, for those that paint them. drawn: What providers drew that draw looks, for
    those that look alike. is_withholding: leaves out the templates that furnish wild rooms. What is computed once for several slots is a
    property."""

    instance: Instance
    caption: Caption | None
    context: Context
    retrieval: Retrieval | None
    neighbors: Sequence[Instance] = ()
    frame: Frame | None = None
    mask: Mask | None = None
    views: Sequence[ColorView] = ()
    unseen: str = ""
    sightlines: Sequence[DepthMap] = ()
    filled: dict[int, MadeAsset] = dataclasses.field(default_factory=dict, repr=False, compare=False)
    drawn: dict[ProviderConfig, MadeAsset] = dataclasses.field(default_factory=dict, repr=False, compare=False)
    is_withholding: bool = False

    @cached_property
    def target(self) -> tuple[NDArray[np.float64], ScannedInstance]:
        """The frame in the world that assets are laid in, 4x4 [m], and the instance in it, as alignment takes it.

        Raises:
            NothingToOffer: the points are not among the blobs.
            InputError: they are no point cloud of this lake.
        """
        if self.instance.points_blob not in self.context.blobs:
            raise NothingToOffer(NO_POINTS)
        return instance_frame(self.instance, self.context, AlignmentConfig())[:2]

    @cached_property
    def view(self) -> Crop | None:
        """The crop of its best view; None where it has none.

        Raises:
            InputError: the picture cannot be read.
        """
        return crop_of_view(self.instance, self.frame, self.mask, self.context.blobs)

    @property
    def held(self) -> list[tuple[float, float, float, float]]:
        """Where neighbors stand on the top of the box: x0, y0, x1, y1 in its frame [m]."""
        pose, size = grown_box(self.instance.box_pose, self.instance.box_size, self.instance.hidden_m)
        places = []
        for other in self.neighbors:
            low = float(other.box_pose[11]) - 0.5 * other.box_size[2]
            if other.instance_id == self.instance.instance_id or abs(low - float(pose[2, 3] + 0.5 * size[2])) > ON_TOP_M:
                continue
            corners = np.column_stack([box_footprint(other.box_pose, other.box_size), np.zeros(4)])
            plan = transform_points(corners, inverse(pose))[:, :2]
            if (np.abs(plan.mean(axis=0)) <= 0.5 * size[:2]).all():
                (x0, y0), (x1, y1) = np.clip([plan.min(axis=0), plan.max(axis=0)], -0.5 * size[:2], 0.5 * size[:2]).tolist()
                places.append((x0, y0, x1, y1))
        return places

    @property
    def category(self) -> str:
        """Category, or the NYU40 class where the label is empty."""
        return self.instance.category or self.instance.nyu40_label

    @property
    def extents(self) -> tuple[float, float, float]:
        """Extents of the box with what the scan could not see [m], no side thinner than `MIN_SIDE_M`."""
        x, y, z = np.maximum(grown_box(self.instance.box_pose, self.instance.box_size, self.instance.hidden_m)[1], MIN_SIDE_M).tolist()
        return x, y, z

    @cached_property
    def points(self) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Points in the frame of the box (+Z up) [m], shape (n, 3), and their colors, shape (n, 3).

        Raises:
            NothingToOffer: the points are not among the blobs.
            InputError: they are no point cloud of this lake.
        """
        name = self.instance.points_blob
        if name not in self.context.blobs:
            raise NothingToOffer(NO_POINTS)
        points, colors = read_points(self.context.blobs[name], name)
        pose, _ = grown_box(self.instance.box_pose, self.instance.box_size, self.instance.hidden_m)
        return transform_points(points, inverse(pose)), colors

    @cached_property
    def color(self) -> tuple[int, int, int] | None:
        """The color that the caption names first, as the instance's points have it; None without a color."""
        if self.caption is None or not self.caption.colors:
            return None
        word = self.caption.colors[0]
        names = name_colors(self.points[1])
        if word in names.words:
            r, g, b = (int(v) for v in names.rgb[names.words.index(word)])
            return r, g, b
        return word_rgb(word)

    @cached_property
    def has_plain_front(self) -> bool:
        """True if the scan shows the instance, and no lines on its upright sides or too little to tell; a drawn box shows nothing."""
        try:
            if len(self.crop.faces) == BOX_FACES:
                return False
            points, colors = self.points
        except (NothingToOffer, InputError, ValueError):
            return False
        try:
            view = self.view
        except InputError:
            view = None
        pose, size = grown_box(self.instance.box_pose, self.instance.box_size, self.instance.hidden_m)
        return not has_lines(points, colors, size, pose, view)

    @cached_property
    def descriptor(self) -> Descriptor:
        """Descriptor of the instance's points."""
        points, colors = self.points
        return describe(points, colors, self.extents, self.rng("descriptor"))

    def rng(self, use: str) -> np.random.Generator:
        """A generator for one use, the instance's own."""
        return self.context.rng(use, self.instance.instance_id)

    @cached_property
    def ranking(self) -> list[LibraryMatch]:
        """The models of the library that come near enough, best first.

        Raises:
            NothingToOffer: there is no library.
        """
        if self.retrieval is None:
            raise NothingToOffer("no library given")
        return self.retrieval.ranking(self)

    @cached_property
    def crop(self) -> Surface:
        """The instance's faces in the frame of its box, bottom at z = 0; raises as `crop_of` does."""
        return crop_of(self.instance, self.context)

    @cached_property
    def field(self) -> SolidField:
        """The solid field of the crop."""
        pose, size = grown_box(self.instance.box_pose, self.instance.box_size, self.instance.hidden_m)
        is_guessed = self.instance.found_by == "geometry" and float(pose[2, 3] - 0.5 * size[2]) <= NEAR_FLOOR_M
        unseen = Unseen.of(self.instance.hidden_m, carried(self.category, self.instance.box_size, is_guessed), self.held)
        return solid_field(self.crop, unseen, self._is_empty if self.sightlines else None)

    def _is_empty(self, nodes: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Nodes that frames saw empty, shape (n,). nodes: in the frame of the crop [m], shape (n, 3)."""
        from scipy.spatial import cKDTree

        pose, size = grown_box(self.instance.box_pose, self.instance.box_size, self.instance.hidden_m)
        is_empty = is_seen_empty(transform_points(nodes, pose @ translation((0, 0, -size[2] / 2))), self.sightlines)
        index = np.flatnonzero(is_empty)
        # Sightlines that graze a surface pass close above it.
        near = cKDTree(self.crop.vertices).query(nodes[index], distance_upper_bound=FREE_DISTANCE_M)[0]
        is_empty[index[np.isfinite(near)]] = False
        return is_empty

    @cached_property
    def pieces(self) -> tuple[trimesh.Trimesh, list[trimesh.Trimesh]]:
        """Convex pieces of the crop and the surface of their union; raises as `pieces_of_crop` does."""
        return pieces_of_crop(self.crop, self.field)
