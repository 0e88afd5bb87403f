"""The policy's network in torch: what each step may see, and the names of its weights."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.policy.actions import START, UNTOLD
from tasks.policy.model.presets import PRESETS
from tasks.policy.model.shapes import shapes_of
from tasks.policy.model.steps import sinusoids, sliding
from tasks.training.systems.navigation import NAVIGATION, NavigationTraining
from tests.tasks.policy.policies import GOALS, MODELS, TINY, drawn_network, drawn_pictures, drawn_weights

torch = pytest.importorskip("torch")


def batch_of(model, windows: int = 3, seed: int = 0) -> dict:
    """Whole windows of random steps."""
    rng = np.random.default_rng(seed)
    size = model.window
    return {
        "pictures": torch.from_numpy(drawn_pictures(model, windows * size, seed)),
        "owner": torch.arange(windows).repeat_interleave(size),
        "places": torch.arange(windows * size).reshape(windows, size),
        "goals": torch.from_numpy(rng.integers(0, len(GOALS), windows)),
        "last": torch.from_numpy(rng.integers(0, UNTOLD + 1, (windows, size))),
        "times": torch.arange(size).expand(windows, -1) + 7,
    }


def test_no_step_sees_what_comes_after_it() -> None:
    module, batch = drawn_network(TINY), batch_of(TINY)
    with torch.no_grad():
        before = module(batch)
        for step in range(1, TINY.window):
            later = dict(batch)
            later["pictures"] = batch["pictures"].clone()
            later["pictures"][batch["places"][:, step:].flatten()] = 255 - later["pictures"][batch["places"][:, step:].flatten()]
            later["last"] = batch["last"].clone()
            later["last"][:, step:] = (later["last"][:, step:] + 1) % (UNTOLD + 1)
            after = module(later)
            assert torch.equal(before[:, :step], after[:, :step])
            assert not torch.allclose(before[:, step:], after[:, step:], atol=1e-4)


def test_windows_do_not_see_each_other() -> None:
    module, batch = drawn_network(TINY), batch_of(TINY)
    with torch.no_grad():
        alone = batch_of(TINY)
        alone = {
            **{name: alone[name][1:2] for name in ("goals", "last", "times")},
            "pictures": batch["pictures"][TINY.window : 2 * TINY.window], "owner": torch.zeros(TINY.window, dtype=torch.int64),
            "places": torch.arange(TINY.window)[None],
        }  # fmt: skip
        assert torch.allclose(module(batch)[1], module(alone)[0], atol=1e-6)


@pytest.mark.parametrize(("name", "changed"), [("blind", "pictures"), ("goalless", "goals")])
def test_who_is_blind_sees_no_picture_and_who_is_goalless_hears_no_goal(name: str, changed: str) -> None:
    model = MODELS[name]
    module, batch = drawn_network(model), batch_of(model)
    other = {**batch, changed: 255 - batch["pictures"] if changed == "pictures" else (batch["goals"] + 1) % len(GOALS)}
    with torch.no_grad():
        assert torch.equal(module(batch), module(other))
        seeing = drawn_network(TINY)
        assert not torch.allclose(seeing(batch), seeing(other), atol=1e-4)


@pytest.mark.parametrize("name", [*MODELS, *PRESETS])
def test_shapes_are_known_without_torch(name: str) -> None:
    model = MODELS.get(name) or PRESETS[name]
    with torch.device("meta") if name == "paper" else torch.device("cpu"):
        from tasks.policy.model.networks.policy import PolicyNet

        module = PolicyNet(model, 7)
    assert {key: tuple(tensor.shape) for key, tensor in module.state_dict().items()} == shapes_of(model, 7)


def test_weights_of_another_policy_are_refused() -> None:
    weights = drawn_weights(TINY)
    NAVIGATION.fits(weights, NavigationTraining(TINY), "file")
    for other in (MODELS["blind"], dataclasses.replace(TINY, decoder_layers=1), dataclasses.replace(TINY, feedforward=8)):
        with pytest.raises(InputError, match="take weights and config of one model"):
            NAVIGATION.fits(weights, NavigationTraining(other), "file")


def test_steps_are_waves_and_windows_slide() -> None:
    waves = sinusoids([[0, 1], [1500, 3]], 8)
    assert waves.shape == (2, 2, 8)
    assert np.allclose(waves[0, 0], [0, 1] * 4)
    assert np.allclose(waves[1, 0, :2], [np.sin(1500), np.cos(1500)], atol=1e-6)
    assert np.allclose(waves[0, 1, 2], np.sin(10_000 ** (-2 / 8)))
    rows, sizes = sliding(5, 3)
    assert sizes.tolist() == [1, 2, 3, 3, 3]
    assert [row[:size].tolist() for row, size in zip(rows, sizes, strict=True)] == [[0], [0, 1], [0, 1, 2], [1, 2, 3], [2, 3, 4]]
    assert (rows < 5).all()
    assert START == 4
