"""An exported USD scene in a simulator: what the certificate calls unstable moves, by nothing but the file, and nothing else."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.disorder import certificates_of, in_disorder
from bench.gravity import left_alone, unstable_of
from bench.rooms import generated_scene
from bench.usd_reader import model_of
from tasks import exports, optimization
from tasks.exports.bodies import Replica
from tasks.exports.mjcf import mjcf_files
from tasks.exports.usd import write_usd
from tasks.exports.usd.rules import check_usd
from tasks.geometry.transforms import rotation_of, translation, yaw_pose
from tasks.optimization.certificates import CertificateConfig
from tasks.optimization.engines.mujoco_engine import mujoco_module
from tasks.stage import Context
from tests.replicas import cube, furnished, obj, rows_of
from tests.tasks.exports.usd.test_exports_usd import replica_of


def tilted(turn: Sequence[float], offset: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Pose that turns about an axis by its length [rad], then moves [m]."""
    pose = translation(offset)
    pose[:3, :3] = rotation_of(turn)
    return pose


def assert_same_as_certificate(replica: Replica, path: Path) -> tuple[set[str], set[str]]:
    """Hold a file against certificates; what moved farther than 1 cm, and farther than 5 cm or 5 degrees."""
    rows = {one.instance_id: one for one in certificates_of(replica) if not one.is_fixed}
    assert all(row.problem is None for row in rows.values())
    settled = left_alone(model_of(path), CertificateConfig().seconds)
    assert {name.rsplit("_", 1)[1] for name in settled} == set(rows), "every free object is a body, and nothing else"
    found = unstable_of(settled)
    far, near = {n for n, row in rows.items() if not row.is_stable_5cm}, {n for n, row in rows.items() if not row.is_stable_1cm}
    assert found.at_5cm == far
    assert found.at_1cm == near
    return near, far


UNSTABLE = (
    cube((0.2, 0.2, 0.2), translation([0.4, 0.4, 0.5]), mass_kg=1.0),  # half a metre in the air
    cube((0.1, 0.1, 0.1), translation([1.8, -1.7, 0.03]), mass_kg=0.5),  # 3 cm
    cube((0.06, 0.06, 0.9), tilted([0.0, 0.2, 0.0], [-2.0, 1.4, 0.006]), mass_kg=0.5),  # leans, and falls over
)


@pytest.mark.whole
def test_what_falls_and_what_rests_is_what_the_certificate_says(tmp_path: Path) -> None:
    objects = [
        *furnished(),
        obj("bookshelf", yaw_pose(1.5707963, [-2.2, -1.7, 0.0]), seed=6, mass_kg=20.0),
        obj("mug", translation([-0.5, -0.2, 0.0]), seed=7, mass_kg=0.3),
        obj("nightstand", yaw_pose(0.0, [0.6, -0.5, 0.0]), seed=8, mass_kg=40.0),
        *UNSTABLE,
    ]
    for instanceable in (False, True):
        config = exports.ExportsConfig(usd=exports.UsdConfig(instanceable=instanceable))
        replica = replica_of(*rows_of(objects), config)
        path = write_usd(tmp_path / str(instanceable), replica, config)
        assert not [finding for finding in check_usd(path) if finding.is_error]
        near, far = assert_same_as_certificate(replica, path)
        assert near == {"0010", "0011", "0012"}
        assert far == {"0010", "0012"}


def test_the_reader_sets_mujoco_as_certificates_do(tmp_path: Path) -> None:
    """Every option, by way of the MuJoCo model that is written beside it."""
    replica = replica_of(*rows_of(furnished()))
    exports.write_folder(tmp_path, {file.path: file.data for file in mjcf_files(replica, exports.ExportsConfig())})
    ours = model_of(write_usd(tmp_path / "usd", replica, exports.ExportsConfig())).opt
    theirs = mujoco_module().MjModel.from_xml_path(str(tmp_path / replica.stem / "scene.xml")).opt
    names = [name for name in dir(ours) if not name.startswith("_")]
    assert {"timestep", "disableflags", "enableflags", "sleep_tolerance"} <= set(names)
    for name in names:
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-6, err_msg=name)


def optimized(index: int) -> tuple[dict[str, list[Any]], dict[str, bytes]]:
    """A generated room after the optimization: rows by table, and blobs."""
    scene = generated_scene(index, 12, 5)
    rows: dict[str, list[Any]] = {**scene.rows, "scenes": []}
    stage = optimization.STAGE
    context = Context(scene.scene_id, stage.name, 5, scene.blobs, defaultdict(dict))
    needed = {table: rows[table] for table in dict.fromkeys((*stage.reads, *stage.history))}
    outcome = stage.run(**needed, context=context, config=optimization.OptimizationConfig())
    return rows | outcome.rows, {**scene.blobs, **outcome.blobs}


@pytest.mark.slow
@pytest.mark.parametrize("index", range(4))
def test_generated_rooms_have_the_unstable_objects_of_their_certificates(index: int, tmp_path: Path) -> None:
    rows, blobs = optimized(index)
    config = exports.ExportsConfig()
    still = replica_of(rows, blobs, config)
    path = write_usd(tmp_path / "still", still, config)
    assert not [finding for finding in check_usd(path) if finding.is_error]
    made = {row.instance_id: row for row in certificates_of(still)}
    stages = {row.instance_id: row for row in rows["certificates"] if row.engine == "mujoco"}
    near, far = assert_same_as_certificate(still, path)
    for name, row in made.items():
        assert (row.is_stable_1cm, row.is_stable_5cm) == (stages[name].is_stable_1cm, stages[name].is_stable_5cm), "the stage's own rows"
    thrown = in_disorder(still, np.random.default_rng(index))
    near_thrown, far_thrown = assert_same_as_certificate(thrown, write_usd(tmp_path / "thrown", thrown, config))
    assert len(near_thrown) > len(near)
    assert len(far_thrown) > len(far)
