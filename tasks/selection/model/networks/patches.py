"""Point encoders of patches: Point-BERT as ULIP-2 has it, and a plain vision transformer shaped as Uni3D."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from tasks.selection.model.config import Patches, Uni3d
from tasks.selection.model.networks.blocks import Pointwise, TransformerBlock, activation_of, centers_of, nearest, normalized_rows, taken


class PatchNet(nn.Module):
    """A PointNet of single patches."""

    def __init__(self, inside: int, first: tuple[int, int], second: tuple[int, int]) -> None:
        super().__init__()
        self.first_conv = nn.Sequential(Pointwise(inside, first[0]), nn.BatchNorm1d(first[0]), nn.ReLU(), Pointwise(first[0], first[1]))
        self.second_conv = nn.Sequential(
            Pointwise(2 * first[1], second[0]), nn.BatchNorm1d(second[0]), nn.ReLU(), Pointwise(second[0], second[1])
        )

    def forward(self, patches: Tensor) -> Tensor:
        """Points of patches, shape (b, g, s, c), to vectors (b, g, out)."""
        first, second = self.first_conv, self.second_conv
        points = first[3](normalized_rows(first[1], first[0](patches)).relu())
        weight, width = self.mixing.weight[..., 0], points.shape[-1]
        # the layer sees the patch's maximum beside each point; as a product of its own it is computed once for a patch
        whole = points.amax(2, keepdim=True) @ weight[:, :width].T
        mixed = points @ weight[:, width:].T + whole + self.mixing.bias
        result: Tensor = second[3](normalized_rows(second[1], mixed).relu()).amax(2)
        return result

    @property
    def mixing(self) -> Pointwise:
        """The layer in which points first see their patch."""
        layer = self.second_conv[0]
        assert isinstance(layer, Pointwise)
        return layer


class BlockList(nn.Module):
    """Blocks of which each is given the places of its tokens."""

    def __init__(self, config: Patches) -> None:
        super().__init__()
        drops = torch.linspace(0, config.drop_path, config.depth, device="cpu").tolist()
        self.blocks = nn.ModuleList(
            TransformerBlock(config.dim, config.heads, 4 * config.dim, activation_of(config.activation), drop) for drop in drops
        )

    def forward(self, tokens: Tensor, places: Tensor) -> Tensor:
        """Shapes (b, t, dim), the same."""
        for block in self.blocks:
            tokens = block(tokens + places)
        return tokens


def grouped(clouds: Tensor, groups: int, size: int, starts: Tensor | None) -> tuple[Tensor, Tensor]:
    """Centers, shape (b, g, 3), and patches about them, shape (b, g, s, 6), of clouds (b, n, 6).

    The first points are the centers, or those that lie apart from given first ones, shape (b,), on. Places are relative to the center,
    colors as they are.
    """
    centers = centers_of(clouds[..., :3], groups, starts)
    patches = taken(clouds, nearest(clouds[..., :3], centers, size))
    return centers, torch.cat([patches[..., :3] - centers[:, :, None], patches[..., 3:]], dim=-1)


def embedded_places(config: Patches) -> nn.Sequential:
    """The network that turns a place, shape (..., 3), into what is added to its token."""
    return nn.Sequential(
        nn.Linear(3, config.position_width), activation_of(config.activation), nn.Linear(config.position_width, config.dim)
    )


class PatchTransformer(nn.Module):
    """Point-BERT: clouds of shape (b, n, 6) to vectors (b, 2 dim), the first token beside the maximum."""

    def __init__(self, config: Patches) -> None:
        super().__init__()
        self.config, self.width = config, 2 * config.dim
        self.encoder = PatchNet(6, config.first_widths, config.second_widths)
        self.reduce_dim = nn.Linear(config.second_widths[1], config.dim)
        self.cls_token = nn.Parameter(torch.zeros(1, 1, config.dim))
        self.cls_pos = nn.Parameter(torch.randn(1, 1, config.dim) * 0.02)
        self.pos_embed = embedded_places(config)
        self.blocks = BlockList(config)
        self.norm = nn.LayerNorm(config.dim)

    def forward(self, clouds: Tensor, starts: Tensor | None = None) -> Tensor:
        """Vectors of clouds."""
        centers, patches = grouped(clouds, self.config.groups, self.config.group_size, starts)
        tokens = self.reduce_dim(self.encoder(patches))
        tokens = torch.cat([self.cls_token.expand(len(tokens), -1, -1), tokens], dim=1)
        places = torch.cat([self.cls_pos.expand(len(tokens), -1, -1), self.pos_embed(centers)], dim=1)
        tokens = self.norm(self.blocks(tokens, places))
        return torch.cat([tokens[:, 0], tokens[:, 1:].amax(1)], dim=-1)


class Vision(nn.Module):
    """Blocks of a vision transformer and the norm of their first token, named as in timm."""

    def __init__(self, config: Uni3d) -> None:
        super().__init__()
        drops = torch.linspace(0, config.drop_path, config.depth, device="cpu").tolist()
        self.blocks = nn.ModuleList(
            TransformerBlock(config.dim, config.heads, config.mlp_width, activation_of(config.activation), drop, split_bias=True)
            for drop in drops
        )
        self.fc_norm = nn.LayerNorm(config.dim)


class PatchVision(nn.Module):
    """Shaped as Uni3D: clouds of shape (b, n, 6) to vectors (b, embedding); places are added once."""

    def __init__(self, config: Uni3d) -> None:
        super().__init__()
        self.config, self.width = config, config.embedding
        self.encoder = PatchNet(6, config.first_widths, config.second_widths)
        self.encoder2trans = nn.Linear(config.second_widths[1], config.dim)
        self.cls_token = nn.Parameter(torch.zeros(1, 1, config.dim))
        self.cls_pos = nn.Parameter(torch.randn(1, 1, config.dim) * 0.02)
        self.pos_embed = embedded_places(config)
        self.visual = Vision(config)
        self.trans2embed = nn.Linear(config.dim, config.embedding)

    def forward(self, clouds: Tensor, starts: Tensor | None = None) -> Tensor:
        """Vectors of clouds."""
        centers, patches = grouped(clouds, self.config.groups, self.config.group_size, starts)
        tokens = self.encoder2trans(self.encoder(patches)) + self.pos_embed(centers)
        tokens = torch.cat([(self.cls_token + self.cls_pos).expand(len(tokens), -1, -1), tokens], dim=1)
        for block in self.visual.blocks:
            tokens = block(tokens)
        result: Tensor = self.trans2embed(self.visual.fc_norm(tokens[:, 0]))
        return result
