"""Steps from noise to layouts, held against diffusers."""

from __future__ import annotations

import numpy as np
import pytest

from tasks.synthesis.inference.schedule import NoiseSchedule

torch = pytest.importorskip("torch")

BETAS = (5e-4, 0.1), (1e-4, 0.02)


def schedulers(steps, betas, target, curve="linear"):
    diffusers = pytest.importorskip("diffusers")
    told = {"v": "v_prediction", "eps": "epsilon"}[target]
    more = {"num_train_timesteps": steps, "beta_start": betas[0], "beta_end": betas[1], "prediction_type": told, "clip_sample": True}
    more["beta_schedule"] = curve
    return diffusers.DDPMScheduler(variance_type="fixed_small", **more), diffusers.DDIMScheduler(**more)


def samples(step, count=3):
    return np.random.default_rng(step).normal(size=(count, 2, 3, 5)).astype(np.float32)


@pytest.mark.parametrize("target", ["v", "eps"])
@pytest.mark.parametrize("curve", ["linear", "scaled_linear"])
@pytest.mark.parametrize(("steps", "betas"), [(7, (1e-3, 0.3)), (200, BETAS[0]), (200, (1e-5, 0.1)), (1000, BETAS[1])])
def test_every_step_is_that_of_diffusers(
    steps: int, betas: tuple[float, float], curve: str, target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    schedule, (ddpm, _) = NoiseSchedule(steps, *betas, target, curve), schedulers(steps, betas, target, curve)
    np.testing.assert_array_equal(schedule.left, ddpm.alphas_cumprod.numpy())
    for step in {*range(0, steps, max(1, steps // 40)), steps - 1}:
        output, sample, noise = samples(step)
        monkeypatch.setattr(torch, "randn", lambda *_, noise=noise, **__: torch.from_numpy(noise))
        wanted = ddpm.step(torch.from_numpy(output), step, torch.from_numpy(sample)).prev_sample
        made = schedule.ddpm(schedule.denoised(output, step, sample), step, sample, noise)
        np.testing.assert_allclose(made, wanted, atol=1e-6, rtol=1e-6)
        assert made.dtype == np.float32


@pytest.mark.parametrize("target", ["v", "eps"])
@pytest.mark.parametrize(("steps", "count"), [(200, 50), (200, 7), (1000, 20), (10, 10)])
def test_fewer_steps_are_those_of_diffusers(steps: int, count: int, target: str) -> None:
    schedule, (_, ddim) = NoiseSchedule(steps, *BETAS[0], target), schedulers(steps, BETAS[0], target)
    ddim.set_timesteps(count)
    some = schedule.some(count)
    assert list(some) == ddim.timesteps.tolist()
    for step, before in zip(some, [*some[1:], None], strict=True):
        output, sample = samples(step, 2)
        wanted = ddim.step(torch.from_numpy(output), step, torch.from_numpy(sample)).prev_sample
        clean, noise = schedule.denoised(output, step, sample), schedule.noise_in(output, step, sample)
        np.testing.assert_allclose(schedule.ddim(clean, noise, before), wanted, atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("count", [0, 201])
def test_no_layout_is_drawn_in_no_steps_or_in_more_than_there_are(count: int) -> None:
    with pytest.raises(ValueError, match="1 to 200"):
        NoiseSchedule(200, *BETAS[0], "v").some(count)
