"""Images of floor, walls and ceiling in the measures of fidelity: color is held against them, and a ceiling counts where there is one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tasks.fidelity.replicas import replica_surface
from tasks.geometry.meshes import dump_glb
from tasks.shell import ShellConfig
from tests.replicas import painted
from tests.tasks.fidelity.test_fidelity import CONFIG, figures, measured, scan_of, scene_of

CLOSED = ShellConfig(ceiling=True)


@pytest.mark.whole
def test_a_replica_with_the_scan_s_images_has_its_colors() -> None:
    rows, blobs = scan_of([])
    images = painted(rows, blobs)["surfaces"]
    looks = replica_surface(rows["shells"][0], [], [], blobs, images).slabs
    scan = blobs.add(dump_glb(looks), "glb")
    rows["scenes"] = [dataclasses.replace(rows["scenes"][0], mesh_blob=scan)]
    plain = scene_of(measured(rows, blobs))
    drawn = scene_of(measured(rows | {"surfaces": images}, blobs))
    assert plain.color_difference is not None
    assert drawn.color_difference is not None
    assert plain.color_difference > 20.0, "random pixels are nothing like one color"
    assert drawn.color_difference < 1.0
    assert figures(drawn, "shell_f") == figures(plain, "shell_f"), "images move nothing"


@pytest.mark.whole
def test_a_scanned_ceiling_is_kept_where_the_replica_has_one() -> None:
    rows, blobs = scan_of([])
    closed = replica_surface(rows["shells"][0], [], [], blobs, shell=CLOSED)
    scan = blobs.add(dump_glb(closed.slabs), "glb")
    rows["scenes"] = [dataclasses.replace(rows["scenes"][0], mesh_blob=scan)]
    rows["instances"] = [dataclasses.replace(rows["instances"][-1], mesh_blob=scan)]
    open_ = scene_of(measured(rows, blobs))
    kept = scene_of(measured(rows, blobs, dataclasses.replace(CONFIG, ceiling=True)))
    assert max(figures(open_, "shell_completeness")) < 0.85
    assert min(figures(kept, "shell_completeness")) > 0.999
    assert min(figures(kept, "shell_accuracy")) > 0.999


def test_of_a_ceiling_only_the_underside_counts() -> None:
    rows, blobs = scan_of([])
    room = rows["shells"][0]
    with_one, without = (replica_surface(room, [], [], blobs, shell=shell).shell for shell in (CLOSED, None))
    added = with_one.faces[len(without.faces) :]
    corners = with_one.vertices[added]
    np.testing.assert_allclose(corners[..., 2], room.height_m)
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < 0).all()
