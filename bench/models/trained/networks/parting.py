"""The network: an encoder and decoder with shortcuts over channels of a frame, as U-Net has them (Ronneberger, Fischer and Brox, MICCAI
2015), of residual blocks (He et al., CVPR 2016).

It begins and ends at half the resolution, four pixels to a vector: half of its work would else be at full resolution.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, pixel_shuffle, pixel_unshuffle, relu

from bench.models.trained.channels import CHANNELS
from bench.models.trained.grouping import PAIRS
from bench.models.trained.things import WORDS

KINDS = 3
"""Of pixels: neither, the support's, and a small object's."""

STRIDE = 16
"""Sides of what it sees are multiples of this [px]."""

CATEGORY_STRIDE = 4
"""Pixels to a vector of logits of categories, along each axis."""

_WIDTHS = (20, 40, 72, 104)
_DECODED = 32


class PartingBlock(nn.Module):
    """Two convolutions and a shortcut."""

    def __init__(self, width: int, dilation: int = 1) -> None:
        super().__init__()
        self.first, self.first_norm = nn.Conv2d(width, width, 3, 1, dilation, dilation, bias=False), nn.BatchNorm2d(width)
        self.second, self.second_norm = nn.Conv2d(width, width, 3, 1, dilation, dilation, bias=False), nn.BatchNorm2d(width)

    def forward(self, x: Tensor) -> Tensor:
        """The same shape."""
        made: Tensor = self.second_norm(self.second(relu(self.first_norm(self.first(x)))))
        return relu(x + made)


def layer(inside: int, outside: int, stride: int = 1) -> nn.Sequential:
    """A convolution, a norm and ReLU."""
    return nn.Sequential(nn.Conv2d(inside, outside, 3, stride, 1, bias=False), nn.BatchNorm2d(outside), nn.ReLU(inplace=True))


class PartingNet(nn.Module):
    """What each pixel is, which pairs of pixels are one object, and what objects are."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = _WIDTHS
        self.stem = nn.Sequential(layer(4 * CHANNELS, a), PartingBlock(a))
        self.down = nn.ModuleList([nn.Sequential(layer(a, b, 2), PartingBlock(b)), nn.Sequential(layer(b, c, 2), PartingBlock(c))])
        self.bottom = nn.Sequential(layer(c, d, 2), PartingBlock(d), PartingBlock(d, 2))
        self.up = nn.ModuleList([layer(d + c, c), layer(c + b, b), nn.Sequential(layer(b + a, _DECODED), PartingBlock(_DECODED))])
        self.pixels = nn.Conv2d(_DECODED, 4 * (KINDS + len(PAIRS)), 1)
        self.categories = nn.Sequential(layer(b, 64), nn.Conv2d(64, len(WORDS), 1))

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Logits of kinds (b, k, h, w), of pairs (b, p, h, w), see `PAIRS`, and of categories (b, n, h / 4, w / 4), of channels
        (b, `CHANNELS`, h, w)."""
        levels = [self.stem(pixel_unshuffle(seen, 2))]
        for down in self.down:
            levels.append(down(levels[-1]))
        x = self.bottom(levels[-1])
        at_quarter = x
        for place, up in enumerate(self.up):
            shortcut = levels[len(levels) - 1 - place]
            x = up(torch.cat([interpolate(x, size=shortcut.shape[-2:], mode="bilinear", align_corners=False), shortcut], dim=1))
            at_quarter = x if place == 1 else at_quarter
        made = pixel_shuffle(self.pixels(x), 2)
        return made[:, :KINDS], made[:, KINDS:], self.categories(at_quarter)
