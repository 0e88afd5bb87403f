"""What is measured of whoever draws layouts: figures against rooms that were held out, and what a kind of room changes."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bench.synthesis.draws import DrawnPart, KeptDraws
from bench.synthesis.rooms import ROOM_TYPES
from bench.synthesis.trainings import HELD, TrainedModel, TrainingRooms, held_layouts, learned_layouts
from flows.run.fingerprints import code_fingerprint, digest
from schemas.files import write_whole
from tasks.furniture import tops
from tasks.micro_scenes.categories import read_categories
from tasks.synthesis.baselines import IndependentDraws, NearestScene
from tasks.synthesis.inference.guidance import Guidance
from tasks.synthesis.layout import Large, Layout
from tasks.synthesis.metrics.boxes import box_figures
from tasks.synthesis.metrics.discrimination import classifier_accuracy, shuffled
from tasks.synthesis.metrics.distances import nearest_figures, variety
from tasks.synthesis.metrics.distributions import category_kl, category_shares, distinct_share, total_variation
from tasks.synthesis.metrics.renders import picture_figures, random_features, torchscript_features

TRUTH, SHUFFLED, INDEPENDENT, NEAREST = "truth again", "truth, shuffled", "independent draws", "nearest scene"
"""What stands beside the models: other rooms by the same rules, held-out layouts with everything somewhere, and two baselines."""

UNGUIDED = "physcene, unguided"
"""The weights of PhyScene without guidance."""

DRAWN, FIGURES = "drawn", "figures"
"""Folders of what models drew, and of figures."""

NO_GUIDANCE = Guidance(share=0.0, settling=0, tries=1)

TABLE = "table"
"""Word of the large object on which kinds of rooms are told apart: it has a rule in each of them."""

CODE = ("tasks.synthesis.inference.drawer", "tasks.synthesis.baselines", "tasks.synthesis.metrics.boxes",
        "tasks.synthesis.metrics.discrimination", "tasks.synthesis.metrics.distances", "tasks.synthesis.metrics.distributions",
        "tasks.synthesis.metrics.renders")  # fmt: skip
"""What figures follow from, besides weights and rooms."""


class Draws(Protocol):
    """Whoever draws a layout on each of some large objects."""

    def draw(self, larges: Sequence[Large], seed: int, /) -> list[Layout]:
        """A layout on each, as the seed has it."""


@dataclasses.dataclass(frozen=True)
class Measurement:
    """Whoever is measured. model: What draws; None for what learns nothing. rooms: That are learned from. scenes: Held-out layouts that
    figures are of. per_room: Layouts of the table in each kind of room. inception: TorchScript file of a feature network; None for an own
    one."""

    name: str
    seed: int
    model: TrainedModel | None
    rooms: TrainingRooms
    scenes: int
    per_room: int
    inception: Path | None = None

    @property
    def mark(self) -> str:
        """What the figures follow from, code and all."""
        own = Path(__file__).read_text()
        weights = self.model.weights if self.model is not None else ""
        network = "" if self.inception is None else digest(self.inception.read_bytes().hex())
        code = [code_fingerprint(module) for module in CODE]
        return digest(own, *code, weights, self.rooms.mark, self.name, str(self.seed), str(self.scenes), str(self.per_room), network)

    def draws(self, folder: Path) -> Draws:
        """What draws. folder: Of what models drew."""
        if self.model is not None:
            return KeptDraws(folder, self.model, NO_GUIDANCE if self.name == UNGUIDED else None)
        if self.name == TRUTH:
            return _Truth(self.rooms.seed + 2 * HELD)
        learned = learned_layouts(self.rooms)
        return IndependentDraws(learned) if self.name == INDEPENDENT else NearestScene(learned)


class _Truth:
    """The rules themselves, drawn once more on the same large objects."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def draw(self, larges: Sequence[Large], seed: int) -> list[Layout]:
        """A layout on each of some large objects, of a word of its category in its kind of room."""
        return [self._drawn(large, np.random.default_rng([self._seed, seed, at])) for at, large in enumerate(larges)]

    @staticmethod
    def _drawn(large: Large, rng: np.random.Generator) -> Layout:
        merged = read_categories().merged
        words = [word for word, room_type in tops.PAIRS if room_type == large.room_type and merged(word) == large.category]
        top = tops.draw(words[int(rng.integers(len(words)))], large.size, large.room_type, rng)
        return Layout(large, tuple(map(merged, top.words)), top.centers, top.sizes, top.yaws)


def parts(folder: Path, what: Measurement) -> list[DrawnPart]:
    """All that a model draws for a measurement, in parts; nothing for what learns nothing."""
    draws = what.draws(folder / DRAWN)
    if not isinstance(draws, KeptDraws):
        return []
    larges = [layout.large for layout in held_layouts(what.scenes, what.rooms)]
    tables = [] if what.name == UNGUIDED else _tables(what.per_room)
    return [*draws.parts(larges, what.seed), *draws.parts(tables, what.seed + HELD)]


def measured(folder: Path, what: Measurement) -> dict[str, Any]:
    """Figures of a measurement as plain values: as the folder holds them, or measured now."""
    mark = what.mark
    path = folder / FIGURES / f"{what.name.replace(', ', '-').replace(' ', '-')}-{what.seed}-{mark[:16]}.json"
    if not path.exists():
        figures = shuffled_figures(what) if what.name == SHUFFLED else figures_of(folder / DRAWN, what)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(figures).encode())
    return {"name": what.name, "seed": what.seed, **json.loads(path.read_bytes())}


def shuffled_figures(what: Measurement) -> dict[str, Any]:
    """How well the classifier tells held-out layouts from the same ones with everything somewhere: whether it can tell anything."""
    truth = held_layouts(what.scenes, what.rooms)
    layouts = shuffled(truth, what.seed)
    return {"sca": dataclasses.asdict(classifier_accuracy(truth, layouts, what.seed)), **dataclasses.asdict(box_figures(layouts))}


def figures_of(folder: Path, what: Measurement) -> dict[str, Any]:
    """All figures of who draws on the large objects of held-out layouts. folder: Of what models drew."""
    truth, learned = held_layouts(what.scenes, what.rooms), learned_layouts(what.rooms)
    draws = what.draws(folder)
    larges = [layout.large for layout in truth]
    clock = time.perf_counter()
    drawn = draws.draw(larges, what.seed)
    seconds = draws.seconds(larges, what.seed) if isinstance(draws, KeptDraws) else time.perf_counter() - clock
    features = random_features() if what.inception is None else torchscript_features(what.inception)
    own, true = variety(drawn, what.seed), variety(truth, what.seed)
    return {
        "ckl": category_kl(truth, drawn),
        **dataclasses.asdict(box_figures(drawn)),
        "objects_per_layout": float(np.mean([len(layout) for layout in drawn])),
        "true_objects_per_layout": float(np.mean([len(layout) for layout in truth])),
        "sca": dataclasses.asdict(classifier_accuracy(truth, drawn, what.seed)),
        "variety_m": own,
        "variety_ratio": own / true if true else float("nan"),
        "distinct": distinct_share(drawn),
        "true_distinct": distinct_share(truth),
        "nearest": dataclasses.asdict(nearest_figures(drawn, truth, learned)),
        "pictures": dataclasses.asdict(picture_figures(truth, drawn, features)),
        "seconds_per_1000": 1000.0 * seconds / len(drawn),
        "rooms": {} if what.name == UNGUIDED else conditioning(draws, what.per_room, what.seed),
    }


def table_in(room_type: str) -> Large:
    """The one table, in a kind of room."""
    return Large(read_categories().merged(TABLE), tops.typical_size(TABLE, np.random.default_rng(0)), room_type)


def _tables(count: int) -> list[Large]:
    """The one table, so often in each kind of room."""
    return [table_in(room_type) for room_type in ROOM_TYPES for _ in range(count)]


def conditioning(draws: Draws, count: int, seed: int) -> dict[str, Any]:
    """How far categories on one table are from what is stated for a kind of room, by that: `own`; from what is stated for the others, in
    the mean: `others`; and how far layouts on it are from each other [m]: `variety_m`. Draws are of numbers that no other figure has."""
    stated = {room_type: tops.stated_distribution(TABLE, room_type) for room_type in ROOM_TYPES}
    drawn = draws.draw(_tables(count), seed + HELD)
    matches = {}
    for at, room_type in enumerate(ROOM_TYPES):
        own = drawn[at * count : (at + 1) * count]
        shares = category_shares(own)
        neighbors = [total_variation(shares, stated[other]) for other in ROOM_TYPES if other != room_type]
        matches[room_type] = {
            "own": total_variation(shares, stated[room_type]), "others": float(np.mean(neighbors)), "variety_m": variety(own, seed),
        }  # fmt: skip
    return matches
