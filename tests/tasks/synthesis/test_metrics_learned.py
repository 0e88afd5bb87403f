"""What a classifier tells apart, and features of pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.synthesis.metrics.discrimination import FOLDS, Classifier, classifier_accuracy, shuffled
from tasks.synthesis.metrics.renders import NOT_COMPARABLE, PIXELS, picture_figures, random_features, torchscript_features
from tests.tasks.synthesis.layouts import desks, layout_of


@pytest.mark.whole
def test_the_classifier_tells_shuffled_layouts_from_true_ones_and_true_ones_from_nothing() -> None:
    true, others = desks(120, 0), desks(120, 1)
    settings = Classifier(epochs=25, batch=32)
    telling = classifier_accuracy(others, shuffled(true, 0), 0, settings)
    assert telling.low >= 0.9
    assert telling.examples == 240
    alike = classifier_accuracy(true, others, 0, settings)
    assert abs(alike.value - 0.5) < 0.1


@pytest.mark.whole
def test_the_order_of_layouts_of_few_or_no_objects_and_a_seed_give_the_same_again() -> None:
    true, others = [layout_of(), *desks(10, 0)], [*desks(10, 1), layout_of()]
    quick = Classifier(epochs=2, batch=8)
    first = classifier_accuracy(true, others, 3, quick)
    assert first == classifier_accuracy(true, others, 3, quick)
    assert first.examples == 22
    assert np.isnan(classifier_accuracy(true[: FOLDS - 1], others, 0).value)


def test_shuffled_layouts_have_the_same_things_inside_the_same_edges() -> None:
    true = desks(50, 0)
    for before, after in zip(true, shuffled(true, 0), strict=True):
        assert (after.large, after.categories) == (before.large, before.categories)
        assert np.array_equal(after.sizes, before.sizes)
        assert np.array_equal(after.yaws, before.yaws)
        assert np.array_equal(after.centers[:, 2], before.centers[:, 2])
        assert not np.allclose(after.centers[:, :2], before.centers[:, :2])
        cos, sin = np.abs(np.cos(after.yaws)), np.abs(np.sin(after.yaws))
        half = 0.5 * np.column_stack([cos * after.sizes[:, 0] + sin * after.sizes[:, 1], sin * after.sizes[:, 0] + cos * after.sizes[:, 1]])
        assert (np.abs(after.centers[:, :2]) + half <= 0.5 * np.array(after.large.size[:2]) + 1e-9).all()


@pytest.mark.whole
def test_own_features_say_so_and_tell_shuffled_pictures_from_true_ones() -> None:
    true, others = desks(60, 0), desks(60, 1)
    features = random_features()
    alike, apart = picture_figures(true, others, features), picture_figures(true, shuffled(others, 0), features)
    assert alike.features == NOT_COMPARABLE
    assert apart.kid > max(3 * alike.kid, 0)
    assert apart.fid > 1.5 * alike.fid
    assert np.isnan(picture_figures(true, others[:1], features).fid)


@pytest.mark.whole
def test_a_network_of_the_users_sees_pictures_of_299_pixels(tmp_path: Path) -> None:
    import torch

    class Mean(torch.nn.Module):
        def forward(self, images: torch.Tensor) -> torch.Tensor:
            assert images.shape[1:] == (3, 299, 299)
            return images.mean(dim=(2, 3), keepdim=True)

    path = tmp_path / "mean.pt"
    torch.jit.script(Mean()).save(str(path))
    images = np.random.default_rng(0).integers(0, 256, (2, PIXELS, PIXELS, 3), dtype=np.uint8)
    found = torchscript_features(path)
    assert found.name == "mean.pt"
    assert found.of(images) == pytest.approx(images.mean(axis=(1, 2)), abs=0.5)
    (tmp_path / "none.pt").write_bytes(b"no network")
    with pytest.raises(InputError, match=r"none\.pt"):
        torchscript_features(tmp_path / "none.pt")
