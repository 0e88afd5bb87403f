"""The policy's network, shaped as SPOC's early fusion (specs E.1).

A picture's tokens and the goal's are read by an encoder together with a fusion token, which is what becomes of the step. With the last
action and the time added, a causal decoder over the last steps, which also sees the goal, tells the next action.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from schemas.evaluation import ACTIONS
from tasks.policy.actions import UNTOLD
from tasks.policy.model.config import OwnEyes, OwnGoal, PolicyModel
from tasks.policy.model.steps import sinusoids

SPREAD = 0.1
"""Of tokens as they are drawn, from 0 up; as published."""


class Goal(nn.Module):
    """What a goal says: tokens (b, g, w) of places in the vocabulary (b,)."""

    states: Tensor

    def __init__(self, config: PolicyModel, goals: int) -> None:
        super().__init__()
        self.is_own = isinstance(config.goal, OwnGoal)
        if isinstance(config.goal, OwnGoal):
            self.vectors = nn.Embedding(goals, config.width)
        else:
            self.register_buffer("states", torch.zeros(goals, config.goal.tokens, config.goal.width))
            self.adapter = adapter(config.goal.width, config.width)

    def forward(self, goals: Tensor) -> Tensor:
        """Tokens of places in the vocabulary."""
        made: Tensor = self.vectors(goals)[:, None] if self.is_own else self.adapter(self.states[goals])
        return made


def adapter(inside: int, outside: int) -> nn.Sequential:
    """A layer, a norm and ReLU."""
    return nn.Sequential(nn.Linear(inside, outside), nn.LayerNorm(outside), nn.ReLU())


class PolicyNet(nn.Module):
    """The next action of each step. goals: Places of the vocabulary; the first one, 0, stands for no goal."""

    def __init__(self, config: PolicyModel, goals: int) -> None:
        super().__init__()
        self.config = config
        width, eyes = config.width, config.eyes
        if not config.blind:
            if isinstance(eyes, OwnEyes):
                parts = (eyes.patch // eyes.part) ** 2
                self.eyes = nn.Sequential(
                    nn.Linear(config.channels * eyes.part**2, eyes.width), nn.ReLU(), nn.Linear(parts * eyes.width, width)
                )
                self.places = nn.Parameter(SPREAD * torch.randn(config.tokens, width))
            else:
                self.eyes = nn.Sequential(nn.Linear(eyes.width, width), nn.ReLU(), nn.Linear(width, width))
            self.adapter = adapter(width, width)
            self.camera = nn.Parameter(SPREAD * torch.rand(width))
        self.goal = Goal(config, goals)
        self.fusion = nn.Parameter(SPREAD * torch.rand(width))
        self.encoder = nn.TransformerEncoder(
            nn.TransformerEncoderLayer(width, config.heads, config.feedforward, config.dropout, batch_first=True),
            config.fusion_layers, enable_nested_tensor=False,
        )  # fmt: skip
        self.last = nn.Embedding(UNTOLD + 1, width)
        nn.init.uniform_(self.last.weight, -0.01, 0.01)
        self.decoder = nn.TransformerDecoder(
            nn.TransformerDecoderLayer(width, config.heads, config.feedforward, config.dropout, batch_first=True), config.decoder_layers
        )
        self.head = nn.Linear(width, len(ACTIONS))

    def goal_tokens(self, goals: Tensor) -> Tensor:
        """Tokens (b, g, w) of goals (b,), places in the vocabulary."""
        made: Tensor = self.goal(torch.zeros_like(goals) if self.config.goalless else goals)
        return made

    def seen(self, pictures: Tensor, goal_tokens: Tensor) -> Tensor:
        """Vectors (n, w) of pictures with the tokens (n, g, w) of what each is seen for.

        pictures: uint8 (n, h, w, c); of frozen eyes the tokens (n, p, e) that these told; of blind models whatever has n of them.
        """
        parts = [self.fusion.expand(len(goal_tokens), 1, -1)]
        if not self.config.blind:
            parts.append(self._tokens(pictures))
        tokens = torch.cat([*parts, goal_tokens], dim=1)
        *before, last = self.encoder.layers
        for layer in before:
            tokens = layer(tokens)
        return first_of(last, tokens)

    def decided(self, seen: Tensor, last: Tensor, times: Tensor, goal_tokens: Tensor) -> Tensor:
        """Logits (b, t, a) of the actions of steps, each of which sees those before it.

        seen: Their vectors (b, t, w). last: Actions before them (b, t). times: Their numbers (b, t). goal_tokens: Shape (b, g, w).
        """
        waves = torch.from_numpy(sinusoids(times.cpu().numpy(), self.config.width)).to(seen)
        steps = seen + self.last(last) + waves
        ahead = torch.triu(torch.ones(seen.shape[1], seen.shape[1], dtype=torch.bool, device=seen.device), diagonal=1)
        made: Tensor = self.head(self.decoder(steps, goal_tokens, tgt_mask=ahead))
        return made

    def forward(self, batch: Mapping[str, Tensor]) -> Tensor:
        """Logits (b, t, a) of windows.

        pictures: Of all steps, window by window (n, ...). owner: Their windows (n,). places: Of the pictures of windows' steps (b, t);
        filled up steps have any. goals (b,), last and times (b, t): As `decided`.
        """
        goal_tokens = self.goal_tokens(batch["goals"])
        seen = self.seen(batch["pictures"], goal_tokens[batch["owner"]])
        return self.decided(seen[batch["places"]], batch["last"], batch["times"], goal_tokens)

    def _tokens(self, pictures: Tensor) -> Tensor:
        """Tokens (n, p, w) of pictures."""
        eyes = self.config.eyes
        if not isinstance(eyes, OwnEyes):
            made: Tensor = self.adapter(torch.relu(self.eyes(pictures.to(self.camera)))) + self.camera
            return made
        values = parts_of(pictures, eyes.patch, eyes.part).to(self.camera) / 127.5 - 1.0
        first, activation, second = self.eyes
        read = torch.relu(second(activation(first(values)).flatten(2)))
        made = self.adapter(read) + self.camera + self.places
        return made


def first_of(layer: nn.TransformerEncoderLayer, tokens: Tensor) -> Tensor:
    """What a layer makes (n, w) of the first of tokens (n, p, w): the others only need to be attended to, which halves its cost."""
    first = tokens[:, :1]
    attended, _ = layer.self_attn(first, tokens, tokens, need_weights=False)
    first = layer.norm1(first + layer.dropout1(attended))
    made: Tensor = layer.norm2(first + layer._ff_block(first))
    return made[:, 0]


def parts_of(pictures: Tensor, patch: int, part: int) -> Tensor:
    """Pixels of pictures (n, h, w, c) by patch and part of it, shape (n, patches, parts, c part^2)."""
    count, height, width, channels = pictures.shape
    inner = patch // part
    cut = pictures.reshape(count, height // patch, inner, part, width // patch, inner, part, channels)
    return cut.permute(0, 1, 4, 2, 5, 3, 6, 7).reshape(count, -1, inner * inner, channels * part * part)
