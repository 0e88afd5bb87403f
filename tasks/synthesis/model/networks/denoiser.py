"""The denoiser of DiffuScene and PhyScene: all slots at once, the large object clean in slot 0 and told to all (specs D.4)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from tasks.synthesis.inference.schedule import left_of
from tasks.synthesis.model.config import Diffusion, Transformer, Unet
from tasks.synthesis.model.encoding import BOX
from tasks.synthesis.model.networks.blocks import ResidualBlock, SlotAttention, Text, encoder, layers, step_waves, waves


class Denoiser(nn.Module):
    """What of noised slots is told: the target of the model's `Noise`.

    Where a config has `categories` as chances, what `class_out` gives is the logarithm of how likely categories are, given all but the
    slot's own noised one-hot, whose likelihood under the noise is known and added. The target follows from the chances.

    classes, large, rooms: Sizes of the vocabulary; `classes` without `empty`. Weights: `text` and `null`; `step`, the step of the diffusion
    as a vector; `condition`, of text and large object; `box_in`, `class_in`, `box_out`, `class_out`; and those of the architecture.
    """

    left: Tensor

    def __init__(self, config: Diffusion, classes: int, large: int, rooms: int) -> None:
        super().__init__()
        self.config = config
        self.text = Text(config.text, large, rooms)
        self.null = nn.Parameter(torch.zeros(config.text.width))
        shape: Any = config.architecture
        width, wide = shape.width, (shape.width if isinstance(shape, Transformer) else 4 * shape.width)
        inner = (width,) if isinstance(shape, Transformer) else (width, 2 * width)
        outer = inner[::-1]  # the widest layer in the middle of the network, as published
        self.step = layers(width, wide, wide)
        self.condition = layers(config.text.width + BOX + classes + 1, wide, wide)
        self.waves = shape.waves if isinstance(shape, Transformer) else 0
        self.box_in, self.class_in = layers(BOX * (1 + self.waves), *inner, width), layers(classes + 1, *inner, width)
        self.box_out, self.class_out = layers(width, *outer, BOX), layers(width, *outer, classes + 1)
        noise = config.noise
        left = left_of(noise.steps, noise.beta_low, noise.beta_high, noise.curve)
        self.register_buffer("left", torch.tensor(left), persistent=False)
        self.body: nn.Module = (
            TransformerBody(shape) if isinstance(shape, Transformer) else UnetBody(shape, config.slots, config.text.width)
        )

    def forward(self, noised: Tensor, steps: Tensor, large: Tensor, room: Tensor, is_null: Tensor | None = None) -> Tensor:
        """What is told of slots (b, s, d), of the same shape; that of slot 0 means nothing.

        noised: Slot 0 is clean. steps: Of the diffusion, from 0, shape (b,). large, room: Places in the vocabulary (b,). is_null: Where the
        text is left out (b,).
        """
        text = self.text(large, room)
        if is_null is not None:
            text = torch.where(is_null[:, None], self.null, text)
        context = self.step(step_waves(steps, self.config.architecture.width)) + self.condition(torch.cat([text, noised[:, 0]], dim=-1))
        box = noised[..., :BOX]
        if self.waves:
            box = torch.cat([box, waves(box, self.waves).flatten(-2)], dim=-1)
        hidden = self.box_in(box) + self.class_in(noised[..., BOX:])
        hidden = self.body(hidden, context[:, None], text[:, None])
        box, category = self.box_out(hidden), self.class_out(hidden)
        if self.config.categories == "chances":
            category = self._target(category, noised[..., BOX:], steps)
        return torch.cat([box, category], dim=-1)

    def _target(self, logits: Tensor, noised: Tensor, steps: Tensor) -> Tensor:
        """The target of one-hots (b, s, k + 1) that are as likely as these logits say before their noised form is looked at."""
        left = self.left[steps][:, None, None]
        signal, noise = left.sqrt(), (1.0 - left).sqrt()
        clean = 2.0 * (logits + 2.0 * signal / (1.0 - left) * noised).softmax(dim=-1) - 1.0
        return (noised - signal * clean) / noise if self.config.noise.target == "eps" else (signal * noised - clean) / noise


class TransformerBody(nn.Module):
    """A transformer that is told the condition with every slot, and which slot is the large object."""

    def __init__(self, shape: Transformer) -> None:
        super().__init__()
        self.large = nn.Parameter(torch.zeros(shape.width))
        self.encoder = encoder(shape.width, shape.heads, shape.feedforward, shape.layers, norm_first=True)

    def forward(self, hidden: Tensor, context: Tensor, text: Tensor) -> Tensor:
        """Slots (b, s, w), of the same shape. told: Shape (b, 1, w). text: Not looked at; it is in what is told."""
        first = hidden[:, :1] + self.large
        return self.encoder(torch.cat([first, hidden[:, 1:]], dim=1) + context)


class UnetBody(nn.Module):
    """Levels down, a middle and levels up, whose layers are of single slots; attention is between them.

    The middle tells slots apart and looks at the text as levels do, and its attention among slots is the usual one.
    """

    def __init__(self, shape: Unet, slots: int, text: int) -> None:
        super().__init__()
        width, wide = shape.width, 4 * shape.width
        self.instances = nn.Parameter(torch.randn(slots, shape.instance_width)) if shape.instance_width else None
        self.down = nn.ModuleList(UnetLevel(shape, text, skips=False) for _ in range(shape.levels))
        self.middle_instance = ResidualBlock(width, width, shape.instance_width, shape.groups) if shape.instance_width else None
        self.middle_first = ResidualBlock(width, width, wide, shape.groups)
        self.middle_text = SlotAttention(width, shape.heads, shape.head_width, linear=True, tokens=text) if shape.crosses else None
        self.middle_attention = SlotAttention(width, shape.heads, shape.head_width, linear=False)
        self.middle_second = ResidualBlock(width, width, wide, shape.groups)
        self.up = nn.ModuleList(UnetLevel(shape, text, skips=True) for _ in range(shape.levels))
        self.last = ResidualBlock(2 * width, width, wide, shape.groups)

    def forward(self, hidden: Tensor, context: Tensor, text: Tensor) -> Tensor:
        """Slots (b, s, w), of the same shape. told: Shape (b, 1, 4 w). text: Tokens that levels look at, shape (b, t, v)."""
        start, skips = hidden, []
        for level in self.down:
            hidden, left = level(hidden, context, text, self.instances, ())
            skips += left
        if self.middle_instance is not None and self.instances is not None:
            hidden = self.middle_instance(hidden, self.instances[None, : hidden.shape[1]])
        hidden = self.middle_first(hidden, context)
        if self.middle_text is not None:
            hidden = self.middle_text(hidden, text)
        hidden = self.middle_second(self.middle_attention(hidden), context)
        for level in self.up:
            hidden, _ = level(hidden, context, text, self.instances, (skips.pop(), skips.pop()))
        return self.last(torch.cat([hidden, start], dim=-1), context)


class UnetLevel(nn.Module):
    """A block that tells slots apart, two that are told the condition, attention to the text between them, then among slots, and a layer.

    Going up, both of the latter see beside their input what the level across left behind.
    """

    def __init__(self, shape: Unet, text: int, *, skips: bool) -> None:
        super().__init__()
        width, wide = shape.width, 4 * shape.width
        inside = 2 * width if skips else width
        self.instance = ResidualBlock(width, width, shape.instance_width, shape.groups) if shape.instance_width else None
        self.first = ResidualBlock(inside, width, wide, shape.groups)
        self.text = SlotAttention(width, shape.heads, shape.head_width, linear=True, tokens=text) if shape.crosses else None
        self.second = ResidualBlock(inside, width, wide, shape.groups)
        self.attention = SlotAttention(width, shape.heads, shape.head_width, linear=True)
        self.out = nn.Linear(width, width)

    def forward(
        self, hidden: Tensor, context: Tensor, text: Tensor, instances: Tensor | None, skips: tuple[Tensor, ...]
    ) -> tuple[Tensor, list[Tensor]]:
        """Slots (b, s, w), of the same shape, and what is left for the level across. skips: What that level left, the later one first."""
        left = []
        if self.instance is not None and instances is not None:
            hidden = self.instance(hidden, instances[None, : hidden.shape[1]])
        hidden = self.first(torch.cat([hidden, *skips[:1]], dim=-1), context)
        left.append(hidden)
        if self.text is not None:
            hidden = self.text(hidden, text)
        hidden = self.attention(self.second(torch.cat([hidden, *skips[1:]], dim=-1), context))
        left.append(hidden)
        return self.out(hidden), left
