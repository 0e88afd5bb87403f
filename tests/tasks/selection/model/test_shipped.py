"""The model inside the package: whole, small, free, and answering without torch."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from schemas.lineage.licenses import OF_THE_SCAN, is_unknown
from tasks.models import CARD, model_id_of
from tasks.selection.model.clouds import ColoredCloud
from tasks.selection.model.features import EVIDENCE, Contender, Scanned
from tasks.selection.model.inference import Scorer, load
from tasks.selection.model.sight import config_from
from tasks.training.systems.selection import SELECTION

SHIPPED = SELECTION.shipped()

ANSWERS = """
import sys
from tasks.selection.model.inference import load
from tasks.selection.model.sight import config_from
from tasks.training.systems.selection import SELECTION
for folder in SELECTION.shipped().values():
    load(folder.model.weights, config_from(folder.model.config))
print("torch" in sys.modules)
"""


@pytest.mark.parametrize("name", SHIPPED)
def test_its_name_is_that_of_its_bytes_and_they_may_be_passed_on(name: str) -> None:
    folder = SHIPPED[name]
    assert folder.model.model_id == model_id_of(folder.model.weights, folder.model.config)
    assert len(folder.model.weights) <= 5_000_000
    licenses = folder.document["license"].split(", ")
    assert not any(each == OF_THE_SCAN or is_unknown(each) for each in licenses)
    card = (folder.folder / CARD).read_text()
    assert folder.model.model_id in card
    for part in ("## Data", "## Held against", "## Limits", folder.document["license"]):
        assert part in card


@pytest.mark.parametrize("name", SHIPPED)
def test_it_prefers_what_was_scanned_to_what_has_another_shape_and_color(name: str) -> None:
    model = SHIPPED[name].model
    scorer = load(model.weights, config_from(model.config))
    assert isinstance(scorer, Scorer)
    rng, wins = np.random.default_rng(0), 0
    for _ in range(20):
        size = rng.uniform(0.2, 1.0, 3)
        color, other = rng.integers(0, 255, (2, 3))
        shape = box_cloud(rng, size, color)
        evidence = {"same": (0.98, 0.95, 0.95, 0.9), "else": (0.6, 0.5, 0.3, 0.3)}
        contenders = [
            Contender(box_cloud(rng, extents, paint), extents.astype(np.float32), np.eye(4), np.ones(3), evidence_of(*evidence[kind]))
            for kind, extents, paint in (("else", size[::-1] * [1.4, 0.7, 1.2], other), ("same", size, color))
        ]
        scan = Scanned(shape, size.astype(np.float32), "cabinet", None, None)
        wins += int(np.argmax(scorer.score(scan, contenders)))
    assert wins >= 18


@pytest.mark.parametrize("name", SHIPPED)
def test_its_scores_are_the_same_bytes_with_any_number_of_threads(name: str) -> None:
    """A run in one process has all cores for matrix products, a worker one."""
    model = SHIPPED[name].model
    scorer, answers = load(model.weights, config_from(model.config)), {}
    for threads in (1, 2, 4):
        rng = np.random.default_rng(0)
        with threadpool_limits(threads, user_api="blas"):
            answers[threads] = [scorer.score(*drawn_question(rng, count)).tobytes() for count in (*range(2, 11), *range(2, 11))]
    assert answers[1] == answers[2] == answers[4]


def drawn_question(rng: np.random.Generator, count: int) -> tuple[Scanned, list[Contender]]:
    """A box that was scanned and photographed, and boxes to choose from."""
    sizes = rng.uniform(0.2, 1.0, (count, 3))
    contenders = [
        Contender(box_cloud(rng, size, rng.integers(0, 255, 3)), size.astype(np.float32), np.eye(4), np.ones(3), evidence_of(*share))
        for size, share in zip(sizes, rng.uniform(0.3, 1.0, (count, 4)), strict=True)
    ]
    image = rng.integers(0, 255, (64, 64, 3), dtype=np.uint8)
    return Scanned(
        box_cloud(rng, sizes[0], rng.integers(0, 255, 3)), sizes[0].astype(np.float32), "cabinet", "A cabinet.", image
    ), contenders


def test_something_ships_and_answers_without_torch() -> None:
    assert SHIPPED
    done = subprocess.run([sys.executable, "-c", ANSWERS], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def box_cloud(rng: np.random.Generator, size: np.ndarray, color: np.ndarray) -> ColoredCloud:
    """Points of the sides of a box that stands on its frame's origin, with their normals."""
    at = rng.uniform(-0.5, 0.5, (512, 3))
    axis, sign = rng.integers(0, 3, 512), rng.choice([-1.0, 1.0], 512)
    at[np.arange(512), axis] = 0.5 * sign
    normals = np.zeros((512, 3), dtype=np.float32)
    normals[np.arange(512), axis] = sign
    points = (at * size + [0.0, 0.0, 0.5 * size[2]]).astype(np.float32)
    return ColoredCloud(points, np.broadcast_to(color.astype(np.uint8), (512, 3)).copy(), normals)


def evidence_of(coverage: float, iou: float, color: float, closeness: float) -> np.ndarray:
    """Evidence of a candidate by name; what is not told is nothing."""
    values = dict.fromkeys(EVIDENCE, 0.0)
    values |= dict(zip(list(EVIDENCE)[:3], (coverage, iou, color), strict=True))
    values[list(EVIDENCE)[5]] = closeness
    return np.array([values[key] for key in EVIDENCE], dtype=np.float32)
