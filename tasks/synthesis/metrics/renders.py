"""KID and FID: how far pictures of drawn layouts are from those of true ones, in the features of a network that is a parameter.

Features of Inception want weights that the user names. Without them, features of an own network stand in whose weights are drawn and
fixed: they tell better from worse on the same pictures, and their figures are not comparable with anybody else's.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from schemas.errors import InputError
from tasks.synthesis.layout import Array, Layout
from tasks.synthesis.pictures import Image, from_above

PIXELS = 256
"""Side of the pictures whose features are compared."""

NOT_COMPARABLE = "fixed random features, not comparable"

_BATCH = 64


@dataclasses.dataclass(frozen=True)
class PictureFeatures:
    """A network of features. of: Features of pictures, shape (n, h, w, 3) RGB, as shape (n, d). name: What figures say that they are of."""

    name: str
    of: Callable[[Image], Array]


@dataclasses.dataclass(frozen=True)
class PictureFigures:
    """features: Name of the network. kid: Squared distance of means in the kernel's space; can be below 0. fid: Fréchet distance."""

    features: str
    kid: float
    fid: float


def picture_figures(truth: Sequence[Layout], drawn: Sequence[Layout], features: PictureFeatures) -> PictureFigures:
    """KID and FID of layouts seen from above. Two layouts at least on either side, else NaN."""
    if min(len(truth), len(drawn)) < 2:
        return PictureFigures(features.name, np.nan, np.nan)
    x, y = (_features(layouts, features) for layouts in (truth, drawn))
    return PictureFigures(features.name, kid(x, y), fid(x, y))


def kid(x: ArrayLike, y: ArrayLike) -> float:
    """Squared maximum mean discrepancy of features, unbiased, kernel (x·y/d + 1)^3; shapes (n, d) and (m, d), 2 rows at least."""
    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    n, m, d = len(a), len(b), a.shape[1]
    within_a, within_b, between = ((p @ q.T / d + 1.0) ** 3 for p, q in ((a, a), (b, b), (a, b)))
    first = (within_a.sum() - np.trace(within_a)) / (n * (n - 1))
    second = (within_b.sum() - np.trace(within_b)) / (m * (m - 1))
    return float(first + second - 2.0 * between.mean())


def fid(x: ArrayLike, y: ArrayLike) -> float:
    """Fréchet distance of two normal distributions with the means and covariances of features, shapes (n, d) and (m, d)."""
    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    return frechet_distance(a.mean(axis=0), np.cov(a, rowvar=False), b.mean(axis=0), np.cov(b, rowvar=False))


def frechet_distance(mean_a: ArrayLike, covariance_a: ArrayLike, mean_b: ArrayLike, covariance_b: ArrayLike) -> float:
    """Squared 2-Wasserstein distance of two normal distributions; means of shape (d,), covariances of shape (d, d), of any rank."""
    a, b = (np.atleast_2d(np.asarray(value, dtype=np.float64)) for value in (covariance_a, covariance_b))
    values, vectors = np.linalg.eigh(a)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    middle = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ b @ root), 0.0)).sum()  # the trace of the root of a b
    apart = np.asarray(mean_a, dtype=np.float64) - np.asarray(mean_b, dtype=np.float64)
    return float((apart**2).sum() + np.trace(a) + np.trace(b) - 2.0 * middle)


def random_features() -> PictureFeatures:
    """Features of an own network of convolutions with fixed drawn weights, 128 of them; figures of them are not comparable."""
    return PictureFeatures(NOT_COMPARABLE, _random_features)


def torchscript_features(path: Path) -> PictureFeatures:
    """Features of a TorchScript network in a file: pictures, shape (n, 3, 299, 299), values 0..255, give (n, d) or (n, d, 1, 1).

    Raises:
        InputError: the file holds no such network.
    """
    import torch

    try:
        network = torch.jit.load(str(path), map_location="cpu").eval()
    except (RuntimeError, OSError, ValueError) as error:
        problem = f"cannot be read as TorchScript: {str(error).splitlines()[0]}"
        raise InputError(str(path), "", problem, "name a network saved by torch.jit.save") from error

    def features_of(images: Image) -> Array:
        pixels = torch.from_numpy(images).permute(0, 3, 1, 2).float()
        with torch.inference_mode():
            matches = network(torch.nn.functional.interpolate(pixels, (299, 299), mode="bilinear", antialias=True))
        return np.asarray(matches.reshape(len(images), -1).double().numpy())

    return PictureFeatures(path.name, features_of)


def _features(layouts: Sequence[Layout], features: PictureFeatures) -> Array:
    """Features of the pictures of layouts, shape (n, d); never are all pictures in memory at once."""
    batches = (layouts[at : at + _BATCH] for at in range(0, len(layouts), _BATCH))
    return np.concatenate([features.of(np.stack([from_above(layout, PIXELS) for layout in batch])) for batch in batches])


def _random_features(images: Image) -> Array:
    """Means and maxima of responses at two scales, shape (n, 128)."""
    import torch

    generator = torch.Generator().manual_seed(0)
    functional = torch.nn.functional
    values = torch.from_numpy(images).permute(0, 3, 1, 2).float() / 127.5 - 1.0
    values = functional.interpolate(values, (64, 64), mode="area")
    matches = []
    with torch.inference_mode():
        for channels_in, channels in ((3, 16), (16, 48)):
            weight = torch.randn(channels, channels_in, 3, 3, generator=generator) / (9 * channels_in) ** 0.5
            values = functional.relu(functional.conv2d(values, weight, stride=2, padding=1)) * 2.0**0.5
            matches += [values.mean(dim=(2, 3)), values.amax(dim=(2, 3))]
    return np.asarray(torch.cat(matches, dim=1).double().numpy())
