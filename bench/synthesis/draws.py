"""What models draw for the benchmark, kept in a folder in parts: processes draw them side by side, and none is drawn twice."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bench.synthesis.trainings import TrainedModel
from flows.run.fingerprints import code_fingerprint, digest
from schemas.files import write_whole
from tasks.models import identity_json
from tasks.synthesis.inference.guidance import Guidance
from tasks.synthesis.layout import Large, Layout
from tasks.weights import from_safetensors, to_safetensors

PART = 256
"""Layouts of a part. What is drawn of a number does not hang on the others."""


@dataclasses.dataclass(frozen=True)
class DrawnPart:
    """Some of the layouts that a model draws with a seed. larges: Large objects. first: Number of the first one. guidance: By physics; the
    model's own where there is none."""

    model: TrainedModel
    larges: tuple[Large, ...]
    first: int
    seed: int
    guidance: Guidance | None

    @property
    def mark(self) -> str:
        """What the layouts follow from, code and all."""
        code = code_fingerprint("tasks.synthesis.inference.drawer")
        config = identity_json(self.model.training.config.model)
        return digest("drawn-1", code, config, self.model.weights, repr(self.larges), str(self.first), str(self.seed), repr(self.guidance))


def drawn_part(folder: Path, part: DrawnPart) -> DrawnPart:
    """Draw a part where the folder does not hold it; the part."""
    path = folder / f"{part.mark}.safetensors"
    if not path.exists():
        numbers = range(part.first, part.first + len(part.larges))
        drawer = part.model.drawer()
        clock = time.perf_counter()
        layouts = drawer.draw(part.larges, part.seed, numbers, guidance=part.guidance)
        seconds = time.perf_counter() - clock
        names = json.dumps([layout.categories for layout in layouts]).encode()
        folder.mkdir(parents=True, exist_ok=True)
        arrays = {
            "categories": np.frombuffer(names, dtype=np.uint8),
            "boxes": np.concatenate([np.column_stack([layout.centers, layout.sizes, layout.yaws]) for layout in layouts]),
            "seconds": np.array([seconds]),
        }
        write_whole(path, to_safetensors(arrays))
    return part


@dataclasses.dataclass(frozen=True)
class KeptDraws:
    """A model whose layouts a folder keeps. guidance: As in `DrawnPart`."""

    folder: Path
    model: TrainedModel
    guidance: Guidance | None = None

    def parts(self, larges: Sequence[Large], seed: int) -> list[DrawnPart]:
        """The parts of a drawing."""
        return [
            DrawnPart(self.model, tuple(larges[first : first + PART]), first, seed, self.guidance) for first in range(0, len(larges), PART)
        ]

    def draw(self, larges: Sequence[Large], seed: int) -> list[Layout]:
        """A layout on each of some large objects; what the folder lacks is drawn now."""
        return [layout for part in self.parts(larges, seed) for layout in self._read(drawn_part(self.folder, part))]

    def seconds(self, larges: Sequence[Large], seed: int) -> float:
        """Time that drawing took [s], of all parts together."""
        return sum(float(self._arrays(drawn_part(self.folder, part))["seconds"][0]) for part in self.parts(larges, seed))

    def _arrays(self, part: DrawnPart) -> dict[str, np.ndarray]:
        return dict(from_safetensors((self.folder / f"{part.mark}.safetensors").read_bytes()))

    def _read(self, part: DrawnPart) -> Iterator[Layout]:
        arrays, first = self._arrays(part), 0
        for large, names in zip(part.larges, json.loads(arrays["categories"].tobytes()), strict=True):
            box = arrays["boxes"][first : first + len(names)]
            first += len(names)
            yield Layout(large, tuple(names), box[:, :3], box[:, 3:6], box[:, 6])
