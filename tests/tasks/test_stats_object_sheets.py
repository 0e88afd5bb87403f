"""Sheets of objects: the photo, and every candidate below its slot."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from tasks.geometry.meshes import dump_glb
from tasks.geometry.transforms import yaw_pose
from tasks.stats.object_sheets import COLUMNS, PHOTO_PX, object_sheet, seen
from tasks.stats.thumbnails import OBJECT_PX, object_thumbnail

COLORS = [(200, 30, 30), (30, 160, 40), (40, 60, 200), (210, 200, 40), (30, 190, 190), (190, 60, 190), (20, 20, 20), (120, 70, 20),
          (130, 140, 40), (90, 60, 130)]  # fmt: skip


def plain(color: tuple[int, int, int], edge: int = OBJECT_PX) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (edge, edge), color).save(file, "JPEG", quality=95)
    return file.getvalue()


def places(sheet: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Pixels of a color, as rows and columns, shape (n, 2)."""
    return np.argwhere(np.abs(sheet.astype(int) - color).max(axis=2) < 12)


@given(slots=st.sets(st.integers(1, 10)).map(sorted), has_photo=st.booleans())
def test_candidates_stand_in_order_beside_the_photo(slots: list[int], has_photo: bool) -> None:
    photo = plain((255, 0, 255), 500) if has_photo else None
    data = object_sheet("a chair", photo, [(slot, plain(COLORS[slot - 1])) for slot in slots])
    with Image.open(io.BytesIO(data)) as opened:
        assert opened.format == "JPEG"
        sheet = np.asarray(opened)
    shown = places(sheet, (255, 0, 255))
    assert (len(shown) > 0.98 * PHOTO_PX**2) == has_photo
    middles = []
    for slot in slots:
        found = places(sheet, COLORS[slot - 1])
        middle = np.median(found, axis=0)
        near = found[(np.abs(found - middle) <= OBJECT_PX / 2).all(axis=1)]
        assert len(near) > 0.95 * OBJECT_PX**2, f"candidate {slot} is whole"
        assert middle[1] > PHOTO_PX
        middles.append(middle)
    for index, middle in enumerate(middles):
        if index % COLUMNS:
            assert middle[1] > middles[index - 1][1] + OBJECT_PX
            assert middle[0] == pytest.approx(middles[index - 1][0], abs=2)
        elif index:
            assert middle[0] > middles[index - 1][0] + OBJECT_PX


def test_an_object_is_shown_by_its_view_else_by_its_faces() -> None:
    wide = trimesh.creation.box((0.3, 1.0, 0.5))
    wide.visual.vertex_colors = np.full((8, 4), 200, dtype=np.uint8)
    mesh = dump_glb([wide.copy().apply_transform(yaw_pose(1.1, (4.0, -2.0, 1.0)))])
    assert seen(b"a photo", mesh, 1.1) == b"a photo"
    assert seen(None, None, 1.1) is None
    drawn = seen(None, mesh, 1.1)
    assert drawn is not None
    pictures = []
    for data in (drawn, object_thumbnail([wide], px=PHOTO_PX)):
        with Image.open(io.BytesIO(data)) as opened:
            assert opened.size == (PHOTO_PX, PHOTO_PX)
            pictures.append(np.asarray(opened, dtype=float))
    assert np.abs(pictures[0] - pictures[1]).mean() < 1.0, "turned back by its yaw, it is the asset that it was scanned from"
