"""Color words of a set of pixels or points, named in CIELAB so that shading changes them little."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.geometry.colors import linear_of

Array = NDArray[np.float64]

D65_WHITE: Array = np.array([0.95047, 1.0, 1.08883])
"""White point of sRGB (IEC 61966-2-1) in XYZ."""

_TO_XYZ: Array = np.array([[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]])

NEUTRAL_SATURATION, NEUTRAL_SATURATION_DARK = 0.085, 0.15
"""Saturation C / (L + 16) below which a light (L 80) and a dark (L 45) color is a gray. On white walls the lamp's tint and
sensor noise reach 0.08; of dark objects people name a hue only where it is stronger."""

LIGHTNESS_WEIGHT = 0.4
"""Lightness counts less than hue and saturation: a shadow halves lightness but leaves the other two where they were."""

WHITE_FROM = 78.0
"""An object two fifths of whose grays are lighter than this (L) is white in light and gray only in its own shadow."""

SHADOW_RATIO = 0.72
"""Lightness of a matte surface turned away from the light, as a share of its lit side: Lambert at 70 degrees with ambient light."""

BLACK_TO, DARK_TO, GRAY_TO, LIGHT_TO = 24.0, 44.0, 68.0, 84.0
"""Lightness L at which the grays change their name."""

MIN_SHARE = 0.05
"""Words on fewer points are left out: bleeding from neighbors at the border of a segment reaches some percent."""

MAX_WORDS = 5
"""No person names more colors of one object."""

_WORDS: dict[str, tuple[tuple[int, int, int], ...]] = {
    "red": ((205, 25, 30), (230, 60, 55)),
    "dark red": ((105, 15, 25), (130, 30, 40)),
    "pink": ((245, 160, 185), (230, 110, 150)),
    "orange": ((245, 130, 25), (240, 105, 40), (250, 165, 70)),
    "brown": ((140, 85, 45), (165, 115, 75), (125, 70, 30), (180, 125, 80), (142, 116, 84), (115, 97, 72)),
    "dark brown": ((80, 48, 25), (62, 42, 30)),
    "beige": ((215, 190, 155), (200, 175, 140), (225, 205, 175)),
    "cream": ((245, 235, 205), (240, 225, 185)),
    "yellow": ((245, 220, 40), (225, 195, 60)),
    "olive": ((110, 110, 40), (130, 125, 70)),
    "green": ((45, 150, 60), (90, 170, 80), (120, 190, 110), (125, 152, 120)),
    "dark green": ((25, 75, 35), (40, 70, 45), (68, 90, 66)),
    "teal": ((20, 120, 120), (40, 100, 105)),
    "turquoise": ((60, 205, 200), (30, 190, 210)),
    "light blue": ((150, 195, 230), (120, 175, 225)),
    "blue": ((35, 85, 190), (50, 110, 200), (70, 105, 160), (85, 103, 130)),
    "navy": ((20, 30, 80), (30, 40, 95), (45, 55, 80)),
    "purple": ((110, 50, 150), (150, 100, 180), (90, 60, 110)),
}

GRAYS = ("black", "dark gray", "gray", "light gray", "white")
WORDS: tuple[str, ...] = (*GRAYS, *_WORDS)
"""Every word that `name_colors` can answer."""

_GRAY_RGB = {word: (level, level, level) for word, level in zip(GRAYS, (28, 85, 130, 188, 240), strict=True)}


@dataclasses.dataclass(frozen=True)
class ColorNames:
    """Color words of an object, most frequent first, and the share of its points that each has (words below
    `MIN_SHARE` are left out, so the shares may add up to less than one).

    rgb: Typical lit color per word, shape (n, 3) uint8. per_point: Index into `WORDS` of every named point.
    """

    words: tuple[str, ...]
    shares: tuple[float, ...]
    rgb: NDArray[np.uint8]
    per_point: NDArray[np.int64]


def lab(rgb: ArrayLike) -> Array:
    """CIELAB (D65) of sRGB colors 0..255. Shape (n, 3) to (n, 3): L in 0..100, a, b."""
    t = linear_of(np.asarray(rgb, dtype=np.float64) / 255.0) @ _TO_XYZ.T / D65_WHITE
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def _coordinates(colors_lab: Array) -> Array:
    """Coordinates in which prototypes are compared, shape (n, 3): saturation along a and b times 100, weighted lightness.

    Light of strength k scales f(X), f(Y), f(Z) of CIELAB by the cube root of k, so a / (L + 16) and b / (L + 16) do not
    change with it (CIE 15, equations of L*a*b*).
    """
    lightness = colors_lab[:, 0]
    return np.column_stack([100 * colors_lab[:, 1:] / (lightness + 16)[:, None], LIGHTNESS_WEIGHT * lightness])


@cache
def _prototypes() -> tuple[Array, NDArray[np.int64]]:
    """Prototype coordinates, shape (p, 3), and the index into WORDS of each."""
    rgb = [color for colors in _WORDS.values() for color in colors]
    index = [WORDS.index(word) for word, colors in _WORDS.items() for _ in colors]
    return _coordinates(lab(np.array(rgb))), np.array(index, dtype=np.int64)


def _name_grays(lightness: Array) -> NDArray[np.int64]:
    """Index into GRAYS per gray point, shape (n,). A white object's shaded side is white."""
    word = np.searchsorted([BLACK_TO, DARK_TO, GRAY_TO, LIGHT_TO], lightness, side="right")
    if len(lightness):
        lit = float(np.percentile(lightness, 90))
        if lit >= WHITE_FROM and float(np.percentile(lightness, 60)) >= WHITE_FROM:
            word = np.where(lightness >= SHADOW_RATIO * lit, 4, word)
    return word.astype(np.int64)


def name_colors(rgb: ArrayLike, max_points: int = 6000) -> ColorNames:
    """Color words of points or pixels, shape (n, 3) uint8. At most `max_points`, evenly spread over the input, are looked at."""
    colors = np.asarray(rgb, dtype=np.uint8).reshape(-1, 3)
    if not len(colors):
        return ColorNames((), (), np.empty((0, 3), np.uint8), np.empty(0, np.int64))
    if len(colors) > max_points:
        colors = colors[np.linspace(0, len(colors) - 1, max_points).astype(np.int64)]
    points = lab(colors)
    saturation = np.hypot(points[:, 1], points[:, 2]) / (points[:, 0] + 16)
    # Below L = 12 the hue is noise of the sensor.
    neutral = np.interp(points[:, 0], [45, 80], [NEUTRAL_SATURATION_DARK, NEUTRAL_SATURATION])
    gray = (saturation < neutral) | (points[:, 0] < 12)
    named = np.empty(len(colors), dtype=np.int64)
    named[gray] = _name_grays(points[gray, 0])
    prototypes, words = _prototypes()
    rest = _coordinates(points[~gray])
    distance = (rest**2).sum(axis=1)[:, None] - 2 * rest @ prototypes.T + (prototypes**2).sum(axis=1)
    named[~gray] = words[distance.argmin(axis=1)]
    counts = np.bincount(named, minlength=len(WORDS))
    order = [int(i) for i in np.argsort(-counts, kind="stable") if counts[i] >= MIN_SHARE * len(colors)][:MAX_WORDS]
    typical = [_lit_color(colors[named == i], points[named == i, 0]) for i in order]
    shares = tuple(float(counts[i] / len(colors)) for i in order)
    return ColorNames(tuple(WORDS[i] for i in order), shares, np.array(typical, dtype=np.uint8).reshape(-1, 3), named)


def _lit_color(colors: NDArray[np.uint8], lightness: Array) -> NDArray[np.uint8]:
    """Median of the lighter half of colors: what a surface looks like out of its own shadow."""
    lighter = colors[lightness >= np.median(lightness)]
    return np.asarray(np.round(np.median(lighter, axis=0)), dtype=np.uint8)


def word_rgb(word: str) -> tuple[int, int, int]:
    """A typical sRGB color of a color word.

    Raises:
        KeyError: the word is none of `WORDS`.
    """
    return _GRAY_RGB[word] if word in _GRAY_RGB else _WORDS[word][0]


def roughness(positions: Array, rgb: ArrayLike, sample: int = 400, neighbors: int = 8) -> float:
    """How much lightness varies from a point to its neighbors, 0 (plain) to 1 (mottled).

    Median over `sample` points of the standard deviation of L among `neighbors` nearest points, 12 L meaning 1:
    carpets and book spines reach that, painted board stays near the sensor's 1 to 2 L.
    """
    from scipy.spatial import cKDTree

    points = np.asarray(positions, dtype=np.float64)
    if len(points) < neighbors + 1:
        return 0.0
    chosen = np.linspace(0, len(points) - 1, min(sample, len(points))).astype(np.int64)
    _, near = cKDTree(points).query(points[chosen], k=neighbors)
    lightness = lab(np.asarray(rgb, dtype=np.uint8)[near.ravel()])[:, 0].reshape(near.shape)
    return float(min(np.median(lightness.std(axis=1)) / 12.0, 1.0))
