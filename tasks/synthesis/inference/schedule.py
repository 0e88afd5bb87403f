"""Steps from noise to layouts (DDPM, DDIM) in NumPy: equal to those of diffusers' schedulers, given the same noise."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float32]

_ONE = np.float32(1)
_LEAST_VARIANCE = np.float32(1e-20)


@dataclasses.dataclass(frozen=True)
class NoiseSchedule:
    """Noise told by its variances in steps 0 (least) to `steps` - 1. All is in single precision, as in training.

    beta_low, beta_high: Variance added in the first and in the last step. curve: What is evenly apart between them, the variances
    (`linear`) or their roots (`scaled_linear`). target: What the denoiser tells: the noise (eps) or the
    velocity (v), `sqrt(a) noise - sqrt(1 - a) sample`, where a is the share of the sample's variance that is left.
    """

    steps: int
    beta_low: float
    beta_high: float
    target: Literal["v", "eps"]
    curve: Literal["linear", "scaled_linear"] = "linear"

    @property
    def left(self) -> Values:
        """Share of the sample's variance that is left after each step, shape (steps,)."""
        return left_of(self.steps, self.beta_low, self.beta_high, self.curve)

    def denoised(self, output: Values, step: int, sample: Values) -> Values:
        """What the denoiser takes the sample for, within -1..1. output, sample: Any shape."""
        left = self.left[step]
        if self.target == "eps":
            clean = (sample - np.sqrt(_ONE - left) * output) / np.sqrt(left)
        else:
            clean = np.sqrt(left) * sample - np.sqrt(_ONE - left) * output
        return np.clip(clean, _ONE * -1, _ONE)

    def noise_in(self, output: Values, step: int, sample: Values) -> Values:
        """The noise that the denoiser sees in the sample."""
        left = self.left[step]
        return output if self.target == "eps" else np.sqrt(left) * output + np.sqrt(_ONE - left) * sample

    def ddpm(self, clean: Values, step: int, sample: Values, noise: Values | None) -> Values:
        """The sample a step earlier, of the posterior with small variance. clean: As `denoised` gives it. noise: Normal; None in step 0."""
        left = self.left[step]
        before = self.left[step - 1] if step else _ONE
        kept = left / before
        mean = np.sqrt(before) * (_ONE - kept) / (_ONE - left) * clean + np.sqrt(kept) * (_ONE - before) / (_ONE - left) * sample
        if step == 0 or noise is None:
            return mean
        variance = np.maximum((_ONE - before) / (_ONE - left) * (_ONE - kept), _LEAST_VARIANCE)
        return mean + np.sqrt(variance) * noise

    def ddim(self, clean: Values, noise: Values, before: int | None) -> Values:
        """The sample of an earlier step, without new noise. clean, noise: As `denoised` and `noise_in` give them. before: The earlier
        step; None is the one without noise."""
        if before is None:
            return clean
        left = self.left[before]
        return np.sqrt(left) * clean + np.sqrt(_ONE - left) * noise

    def some(self, count: int) -> Sequence[int]:
        """So many steps from a noisy one on, evenly apart, the last one 0.

        Raises:
            ValueError: there are not so many.
        """
        if not 1 <= count <= self.steps:
            raise ValueError(f"a layout is drawn in 1 to {self.steps} steps, not in {count}")
        return [at * (self.steps // count) for at in reversed(range(count))]


@cache
def left_of(steps: int, low: float, high: float, curve: str) -> Values:
    """As diffusers has it to the last bit: single precision, rounded once after a product and its sum, and after all products."""
    root = curve == "scaled_linear"
    first, last = (np.float32(beta**0.5 if root else beta) for beta in (low, high))
    stride, index = np.float64((last - first) / np.float32(steps - 1)), np.arange(steps)
    betas = np.where(index < steps // 2, first + stride * index, last - stride * (steps - 1 - index)).astype(np.float32)
    betas = betas * betas if root else betas
    left = np.cumprod((_ONE - betas).astype(np.float64)).astype(np.float32)
    left.setflags(write=False)
    return left
