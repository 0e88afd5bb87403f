"""Newton as a second engine: asked only when its interpreter is named, in words for people when it is not there."""

from __future__ import annotations

import dataclasses
import os
import sys
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from schemas.errors import InputError
from schemas.optimization import Certificate
from schemas.record import check
from tasks.geometry.pieces import Hull
from tasks.geometry.transforms import translation, yaw_pose
from tasks.optimization.certificates import CertificateConfig, Certified, certificate_rows, certify
from tasks.optimization.engines import newton_engine
from tasks.optimization.engines.newton_engine import Newton
from tasks.optimization.solids import shell_solids
from tests.replicas import room_of
from tests.tasks.optimization.test_certificates import Array, body, box, cube, in_bytes, table

FLAT = Hull(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 3, 2]]))


def asked(python: str | Path) -> list[Certified]:
    return certify(
        [cube("0001")], np.eye(4)[None], (), CertificateConfig(mujoco_defaults=False, nudge_m_s=0.0, newton=Newton(python=str(python)))
    )


def test_newton_is_not_asked_unless_it_is_named() -> None:
    assert [one.engine for one in asked("")] == ["mujoco"]


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no_such_python: .*newton.python: is no program that can be run; .*newton.lock"):
        asked(tmp_path / "no_such_python")
    with pytest.raises(InputError, match=r"newton.python: Newton ended with code 1: ModuleNotFoundError: .*'newton'; .*newton.lock"):
        asked(sys.executable)
    text = tmp_path / "text"
    text.write_text("no program")
    text.chmod(0o755)
    with pytest.raises(InputError, match="cannot be run"):
        asked(text)
    silent = tmp_path / "silent"
    silent.write_text("#!/bin/sh\n")
    silent.chmod(0o755)
    with pytest.raises(InputError, match="it left no result"):
        asked(silent)


def test_a_name_without_a_folder_and_one_beside_us_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "silent").write_text("#!/bin/sh\n")
    (tmp_path / "silent").chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    for name in ("silent", "./silent"):
        with pytest.raises(InputError, match="it left no result"):
            asked(name)


def test_a_run_that_never_ends_is_ended(tmp_path: Path) -> None:
    endless = tmp_path / "endless"
    endless.write_text("#!/bin/sh\nexec sleep 60\n")
    endless.chmod(0o755)
    config = CertificateConfig(mujoco_defaults=False, nudge_m_s=0.0, newton=Newton(python=str(endless), timeout_s=0.5))
    with pytest.raises(InputError, match=r"longer than 0.5 s; raise timeout_s"):
        certify([cube("0001")], np.eye(4)[None], (), config)


def pinned() -> dict[str, str]:
    """Versions by package."""
    lines = (Path(newton_engine.__file__).parents[3] / "requirements" / "newton.lock").read_text().splitlines()
    return dict(line.split("==") for line in lines if not line.startswith("#"))


def test_the_lock_names_versions_and_no_host() -> None:
    pins = pinned()
    assert {"newton", "mujoco", "mujoco-warp", "warp-lang", "numpy"} <= pins.keys()
    assert pins["mujoco"].split(".")[:2] == pins["mujoco-warp"].split(".")[:2] == ["3", "17"], "what newton 1.8 was made for"


@pytest.fixture(scope="module")
def python() -> str:
    path = os.environ.get("METASCENES_NEWTON_PYTHON", "")
    if not path:
        pytest.skip("METASCENES_NEWTON_PYTHON names no interpreter with requirements/newton.lock installed")
    return path


@pytest.fixture(scope="module", params=["mujoco", "xpbd"])
def both(python: str, request: pytest.FixtureRequest) -> list[tuple[Certified, Certified]]:
    """What MuJoCo and Newton say of objects at rest, in the air, on an edge, fixed, refused."""
    placed: list[tuple[object, Array]] = [
        (table(), np.eye(4)), (cube("0002"), translation([-0.3, 0.4, 0.74])), (cube("0003"), translation([0.3, -0.3, 0.77])),
        (cube("0004", 0.4), yaw_pose(0.4, [2.0, 0.0, 0.0])), (cube("0005", 0.2), yaw_pose(1.4, [2.0, 0.02, 0.4])),
        (dataclasses.replace(cube("0006"), is_fixed=True), translation([0.0, 0.0, 1.5])), (cube("0007"), translation([-2.0, 1.0, 0.5])),
        (cube("0008"), translation([2.8495, -1.2, 0.0])), (cube("0009"), translation([-2.851, -1.0, 0.0])),
        (body("0010", FLAT), translation([1.0, 1.0, 0.1])), (body("0011", box((0.3, 0.3, 0.3))), yaw_pose(0.2, [-1.5, -1.5, 0.0])),
    ]  # fmt: skip
    config = CertificateConfig(mujoco_defaults=False, nudge_m_s=0.0, newton=Newton(python=python, solver=request.param))
    found = certify([b for b, _ in placed], np.array([p for _, p in placed]), shell_solids(room_of()), config)  # type: ignore[misc]
    half = len(placed)
    assert [one.engine for one in found] == ["mujoco"] * half + ["newton"] * half
    return list(zip(found[:half], found[half:], strict=True))


@pytest.mark.slow
def test_the_engines_agree(both: list[tuple[Certified, Certified]]) -> None:
    for ours, theirs in both:
        assert ours.name == theirs.name
        assert (ours.problem is None) == (theirs.problem is None), ours.name
        assert (ours.mass_kg, ours.density_kg_m3, ours.is_fixed) == (theirs.mass_kg, theirs.density_kg_m3, theirs.is_fixed)
        if ours.problem is not None:
            continue
        assert theirs.start_penetration_m == pytest.approx(ours.start_penetration_m, abs=5e-4), ours.name
        is_xpbd = theirs.engine_version.endswith("XPBD")
        if is_xpbd and ours.start_penetration_m > 5e-4:
            continue  # it drives overlaps apart faster than it stops what it drove
        assert (theirs.is_stable_1cm, theirs.is_stable_5cm) == (ours.is_stable_1cm, ours.is_stable_5cm), (ours.name, ours, theirs)
        if ours.is_stable_1cm:
            assert theirs.settled_pose == pytest.approx(ours.settled_pose, abs=6e-3 if is_xpbd else 3e-3), ours.name
    by_name = {theirs.name: theirs for _, theirs in both}
    assert by_name["0007"].displacement_m == pytest.approx(0.5, abs=1e-3)
    assert by_name["0003"].displacement_m == pytest.approx(0.03, abs=1e-3)
    assert by_name["0006"].displacement_m == 0.0
    assert by_name["0010"].problem
    rows = certificate_rows("demo/room", [one for pair in both for one in pair])
    check(rows, Certificate)
    versions = {row.engine: row.engine_version for row in rows}
    pins = pinned()
    assert versions["newton"] in [f"{pins['newton']}, solver {used}" for used in (f"MuJoCo {pins['mujoco']}", "XPBD")]
    assert versions["mujoco"] != versions["newton"]


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["mujoco", "xpbd"])
def test_newton_gives_the_same_bytes_again(python: str, solver: Literal["mujoco", "xpbd"]) -> None:
    objects = [cube("0001"), cube("0002", 0.2)]
    poses = np.array([translation([0, 0, 0.1]), yaw_pose(0.3, [0.05, 0.02, 0.45])])
    config = CertificateConfig(mujoco_defaults=False, nudge_m_s=0.0, newton=Newton(python=python, solver=solver))
    first, again = (certify(objects, poses, (), config) for _ in range(2))
    assert [in_bytes(one) for one in first] == [in_bytes(one) for one in again]
