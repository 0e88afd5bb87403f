"""The data of the benchmark: a lake of generated rooms, scanned, with ten candidates for each instance and simulated annotations.

    python -m bench.selection.data --folder selection --rooms 300 --minutes 120

`<folder>/lake` is a lake like anybody's; `<folder>/truth` says of each room, in a file of its own, what no row says: whose model each
instance shows, and what each slot holds. A room whose file is there is not made again; one that failed is, by the next command.
`--annotate` answers for the rooms that no batch has.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from bench.selection.annotations import annotate
from bench.selection.catalog import Catalog, made_catalog, read_catalog
from bench.selection.lineups import LineupSettings, Offered, candidate_rows, lineup
from bench.selection.measures import source_digest
from bench.selection.rooms import (
    DATASET,
    MOST_OFF_M,
    TrueModel,
    allowed,
    held_out,
    is_hard,
    room_name,
    scan_room,
    split_of_room,
)
from bench.selection.trainings import mapped
from flows.run.fingerprints import ModuleCaches, canonical_json, code_fingerprint, digest
from flows.worker import Job, lost_run
from schemas.candidates import Asset, Candidate
from schemas.capture import Instance
from schemas.errors import InputError
from schemas.files import write_whole
from schemas.navigation import Split
from schemas.tables import TABLES
from tasks import captions
from tasks.annotation.simulation import AnnotatorRule, ModelDifference, ShownModel, dissimilarity
from tasks.candidates.request import CandidateRequest
from tasks.candidates.retrieval import Retrieval
from tasks.capture import scenes as capture
from tasks.capture.formats import find_scans
from tasks.capture.rooms.textures import TextureConfig
from tasks.geometry.meshes import read_points, surface_of, surface_of_glb
from tasks.geometry.proximity import closest_points
from tasks.geometry.transforms import flat, inverse, transform_points
from tasks.selection import SelectionConfig
from tasks.selection import run as select
from tasks.selection.methods.geometric import Geometric
from tasks.stage import Blobs, Context
from warehouse.lake import Lake

CAPTURE = capture.CaptureConfig(
    max_view_frames=16,  # a light walk has thirty
    views_per_instance=1,  # the benchmark's methods look at the best one
    max_faces=20_000,  # nobody looks at the room as a whole
    textures=TextureConfig(texel_m=0.1, max_px=32),  # nor at its walls
)
"""How scans are captured: as in the product where an instance is concerned, and cheaply where none is."""

POINTS = 384
"""Of an instance that are held against its model."""

ROOMS_PER_COMMIT = 8
"""A commit takes one to two seconds, whatever it holds."""

VERSION = "2"
"""Goes up when the same seed and number would give another room or lineup."""


@dataclasses.dataclass(frozen=True)
class DataSettings:
    """What the data set follows from, beside the numbers of its rooms."""

    seed: int = 0
    lineup: LineupSettings = dataclasses.field(default_factory=LineupSettings)
    rule: AnnotatorRule = dataclasses.field(default_factory=AnnotatorRule)

    @property
    def mark(self) -> str:
        """What tells data sets apart."""
        return digest("bench.selection", VERSION, canonical_json(self))


def code() -> str:
    """What the rooms of a data set follow from, beside its settings: hash of the code that makes, scans, captures, offers and aligns."""
    modules = (
        "tasks.furniture.rooms", "tasks.furniture.dwellings", "tasks.scanner", "tasks.scanner.dwellings", "tasks.capture.scenes",
        "tasks.captions", "tasks.candidates", "tasks.selection.evidence",
    )  # fmt: skip
    return digest(*(code_fingerprint(module) for module in modules), source_digest("catalog", "data", "lineups", "rooms"))


@dataclasses.dataclass(frozen=True)
class SelectionData:
    """A data set in a folder.

    Raises:
        InputError: the folder holds data of other settings.
    """

    folder: Path
    settings: DataSettings = dataclasses.field(default_factory=DataSettings)

    def __post_init__(self) -> None:
        mark = self.folder / "settings.json"
        if not mark.exists():
            (self.folder / "truth").mkdir(parents=True, exist_ok=True)
            document = {"mark": self.settings.mark, "code": code(), "settings": json.loads(canonical_json(self.settings))}
            write_whole(mark, json.dumps(document).encode())
        if self._written["mark"] != self.settings.mark:
            raise InputError(str(mark), "mark", "is of data with other settings", "name another folder")

    @property
    def _written(self) -> dict[str, Any]:
        document: dict[str, Any] = json.loads((self.folder / "settings.json").read_bytes())
        return document

    @property
    def is_of_this_code(self) -> bool:
        """Whether the folder was begun by the code that would make its rooms now."""
        return self._written.get("code") == code()

    @property
    def lake(self) -> Lake:
        """Where the rows are."""
        return Lake.open(self.folder / "lake")

    @property
    def catalog_file(self) -> Path:
        """Where the models lie out of which lineups are made."""
        return self.folder / "catalog.json"

    def truth_file(self, index: int) -> Path:
        """Where the truth of a room lies, once it is made."""
        return self.folder / "truth" / f"{room_name(index)}.json"

    def truths(self) -> list[dict[str, Any]]:
        """The truth of all rooms that are made, by name."""
        return [json.loads(path.read_bytes()) for path in sorted((self.folder / "truth").glob("scene*.json"))]

    def make(self, index: int) -> dict[str, Any]:
        """Make a room out of the catalog that lies in the folder: rows staged, truth written last. Returns the truth."""
        truth = make_room(self.lake, index, self.settings, read_catalog(self.catalog_file))
        write_whole(self.truth_file(index), json.dumps(truth).encode())
        return truth


def make_room(lake: Lake, index: int, settings: DataSettings, catalog: Catalog) -> dict[str, Any]:
    """Scan a room, capture it, line candidates up and select among them; its rows are left staged. Returns its truth."""
    seconds: dict[str, float] = {}
    with tempfile.TemporaryDirectory(prefix="selection-", ignore_cleanup_errors=True) as folder:
        with _timed(seconds, "scan"):
            room = scan_room(index, settings.seed, Path(folder))
        scan = find_scans(Path(folder) / room_name(index), dataset=DATASET)[0][0]
        with _timed(seconds, "capture"):
            captured = capture.run(scan=scan, context=Context(scan.scene_id, "capture", settings.seed, Blobs()), config=CAPTURE)
    scene = dataclasses.replace(captured.rows["scenes"][0], scan_path=room_name(index))
    split, offers = split_of_room(index), allowed(index, settings.seed)

    def offer(model: TrueModel, request: CandidateRequest, rng: np.random.Generator) -> list[Offered]:
        return lineup(model, request, offers, catalog, settings.lineup, rng)

    captured.rows["scenes"] = [scene]
    true = room.true_models(scene, captured.rows["instances"])
    known = work(lake, captured.rows, captured.blobs, true, offer, split, settings, seconds)
    rare = held_out(settings.seed)
    for value in known.values():
        value["is_held_out"] = value["category"] in rare
    objects = sum(not row.is_structure for row in captured.rows["instances"])
    return {
        "scene_id": scene.scene_id, "room_id": scene.room_id, "index": index, "split": split, "is_hard": is_hard(index),
        "objects": objects, "instances": known, "cpu_seconds": seconds,
    }  # fmt: skip


Offers = Callable[[TrueModel, CandidateRequest, np.random.Generator], list[Offered]]
"""Candidates of an instance whose model is known, in the order of their slots."""


def work(
    lake: Lake, captured: Mapping[str, list[Any]], files: Mapping[str, bytes], true: Mapping[str, TrueModel], offer: Offers, split: str,
    settings: DataSettings, seconds: dict[str, float], retrieval: Retrieval | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The stages after the capture, and the rows of all of them staged. Gives the truth of the instances that got candidates: those whose
    model is known, and lies on the scan."""
    blobs = Blobs()
    blobs.update(files)
    instances: list[Instance] = [dataclasses.replace(row, mesh_blob=None) if row.is_structure else row for row in captured["instances"]]
    scene = captured["scenes"][0]
    scene_id = scene.scene_id
    with _timed(seconds, "captions"):
        described = captions.run(
            instances=instances, frames=[], masks=[], context=Context(scene_id, "captions", settings.seed, blobs),
            config=captions.CaptionsConfig(),
        ).rows["captions"]  # fmt: skip
    captioned = {row.instance_id: row for row in described}
    context = Context(scene_id, "candidates", settings.seed, blobs, caches=ModuleCaches())
    candidates: list[Candidate] = []
    assets: dict[str, Asset] = {}
    known: dict[str, dict[str, Any]] = {}
    objects = [row for row in instances if not row.is_structure]
    for row in objects:
        model = true.get(row.instance_id)
        off = distance_of(model, row, blobs, context) if model is not None else np.inf
        if model is None or off > MOST_OFF_M:
            continue
        request = CandidateRequest(row, captioned.get(row.instance_id), context, retrieval, objects)
        with _timed(seconds, "candidates"):
            offered = offer(model, request, context.rng("lineup", row.instance_id))
        candidates += candidate_rows(request, offered)
        for each in offered:
            assets.setdefault(each.made.asset.asset_id, each.made.asset)
            blobs.update(each.made.files)
        with _timed(seconds, "differences"):
            known[row.instance_id] = truth_of(model, offered, off, settings, context, row.instance_id)
    listed = [assets[key] for key in sorted(assets)]
    chosen = [row for row in instances if row.is_structure or row.instance_id in known]
    with _timed(seconds, "selection"):
        selections = select(
            instances=chosen, candidates=candidates, assets=listed, context=Context(scene_id, "selection", settings.seed, blobs),
            config=SelectionConfig(provider=Geometric()),  # the rows of other methods are measured from the same poses
        ).rows["selections"]  # fmt: skip
    with _timed(seconds, "rows"):
        rows = {name: captured[name] for name in ("scenes", "shells", "rooms", "frames", "masks")} | {"instances": instances}
        stage_all(lake, scene_id, settings, blobs, {
            "capture": rows,
            "captions": {"captions": described},
            "candidates": {"candidates": candidates, "assets": listed},
            "selection": {"selections": selections},
            "navigation": {"splits": [Split(room_id=scene.room_id, split=split)]},
        })  # fmt: skip
    return known


def truth_of(
    model: TrueModel, offered: Sequence[Offered], off: float, settings: DataSettings, context: Context, instance_id: str
) -> dict[str, Any]:
    """What is true of an instance: its model, and what each slot holds and how much it differs."""
    own = ShownModel.of(model.category, surface_of(model.parts), context.rng("true", instance_id))
    differences: list[ModelDifference] = []
    for number, each in enumerate(offered):
        surface = surface_of_glb(each.made.files[each.made.asset.mesh_blob], each.made.asset.mesh_blob)
        other = ShownModel.of(each.made.asset.category, surface, context.rng("shown", instance_id, number), each.kind == "crop")
        differences.append(dissimilarity(own, other, settings.rule))
    return {
        "model": model.name,
        "category": model.category,
        "pose": list(flat(model.pose)),
        "extents": list(model.extents),
        "scan_distance_m": off,
        "slots": [
            {"kind": each.kind, "asset_id": each.made.asset.asset_id, **dataclasses.asdict(difference)}
            for each, difference in zip(offered, differences, strict=True)
        ],
    }


def distance_of(model: TrueModel, row: Instance, blobs: Mapping[str, bytes], context: Context) -> float:
    """Mean distance of an instance's scanned points from its model at its true pose [m]."""
    points, _ = read_points(blobs[row.points_blob], row.points_blob)
    order = context.rng("distance", row.instance_id).permutation(len(points))[:POINTS]
    surface = surface_of(model.parts)
    return float(closest_points(surface.vertices, surface.faces, transform_points(points[order], inverse(model.pose))).distance.mean())


def stage_all(
    lake: Lake, scene_id: str, settings: DataSettings, blobs: Mapping[str, bytes], stages: Mapping[str, Mapping[str, Sequence[Any]]]
) -> None:
    """Leave the rows of a scene for the next commit, each stage as read by the next, with the blobs that they name."""
    named = {
        value
        for tables in stages.values()
        for table, rows in tables.items()
        for row in rows
        for column in TABLES[table].blob_columns
        if (value := getattr(row, column))
    }
    for name in sorted(named):
        lake.blobs.put(blobs[name], name.partition(".")[2])
    upstream: list[str] = []
    for stage, tables in stages.items():
        fingerprint = digest(settings.mark, scene_id, stage)
        job = Job(lake.address, scene_id, stage, None, "{}", settings.seed, fingerprint, (), tuple(upstream), 1)
        counts = tuple(f"{table}={len(rows)}" for table, rows in sorted(tables.items()))
        lake.stage_rows(dataclasses.replace(lost_run(job, None, None, 0.0), row_counts=counts), tables)
        upstream.append(f"{stage}={fingerprint}")


@contextmanager
def _timed(seconds: dict[str, float], step: str) -> Iterator[None]:
    """Add the processor seconds of what is done to a step's."""
    clock = time.process_time()
    yield
    seconds[step] = round(seconds.get(step, 0.0) + time.process_time() - clock, 4)


def generate(data: SelectionData, rooms: Iterable[int], minutes: float = np.inf, processes: int = 1) -> Iterator[dict[str, Any] | str]:
    """Make the rooms that are not there, until so many minutes have passed, and commit them; gives the truth of each, or a line that says
    why there is none."""
    data.lake.commit("rooms that were left staged")
    lacking = [index for index in rooms if not data.truth_file(index).exists()]
    if lacking:
        with mapped(processes) as spread:
            made_catalog(data.catalog_file, data.settings.seed, spread)
    end = time.monotonic() + 60 * minutes
    wanted = (index for index in lacking if time.monotonic() < end)
    for fresh, made in enumerate(_in_turn(data, wanted) if processes == 1 else _spread(data, wanted, processes), start=1):
        yield made
        if fresh % ROOMS_PER_COMMIT == 0:
            data.lake.commit("generated rooms")
    data.lake.commit("generated rooms")


def _in_turn(data: SelectionData, wanted: Iterator[int]) -> Iterator[dict[str, Any] | str]:
    """Rooms made in this process."""
    for index in wanted:
        try:
            yield data.make(index)
        except Exception as error:  # one room of hundreds: the next command tries it again
            yield _failed(index, error)


def _spread(data: SelectionData, wanted: Iterator[int], processes: int) -> Iterator[dict[str, Any] | str]:
    """Rooms made in processes of their own, as they are done."""
    from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import get_context

    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        at_work: dict[Future[dict[str, Any]], int] = {}
        while True:
            for index in islice(wanted, processes - len(at_work)):
                at_work[pool.submit(data.make, index)] = index
            if not at_work:
                return
            for future in wait(at_work, return_when=FIRST_COMPLETED).done:
                index = at_work.pop(future)
                try:
                    yield future.result()
                except BrokenProcessPool:
                    raise
                except Exception as error:
                    yield _failed(index, error)


def _failed(index: int, error: Exception) -> str:
    return f"{room_name(index)} failed: {type(error).__name__}: {error}"


def counts_of(truths: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What a data set holds: instances by split, those of held-out categories, and processor seconds per room by step."""
    by_split = {split: [t for t in truths if t["split"] == split] for split in ("train", "test")}
    steps = sorted({step for t in truths for step in t["cpu_seconds"]})
    return {
        "rooms": {split: len(rows) for split, rows in by_split.items()},
        "instances": {split: sum(len(t["instances"]) for t in rows) for split, rows in by_split.items()},
        "held_out": {split: sum(i["is_held_out"] for t in rows for i in t["instances"].values()) for split, rows in by_split.items()},
        "cpu_seconds": {step: round(float(np.mean([t["cpu_seconds"].get(step, 0.0) for t in truths])), 2) for step in steps},
    }


def main() -> None:
    """Make the data set, as the module says."""
    parser = argparse.ArgumentParser(prog="python -m bench.selection.data", description=__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--rooms", type=int, default=300)
    parser.add_argument("--minutes", type=float, default=np.inf, help="begin no room after so many")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--annotate", action="store_true", help="then answer for the rooms that no batch has")
    options = parser.parse_args()
    data = SelectionData(options.folder, DataSettings(options.seed))
    for truth in generate(data, range(options.rooms), options.minutes, options.processes):
        if isinstance(truth, str):
            print(truth, flush=True)
            continue
        total = sum(truth["cpu_seconds"].values())
        print(f"{truth['scene_id']} {truth['split']} {len(truth['instances'])} of {truth['objects']} instances, {total:.1f} s: "
              f"{truth['cpu_seconds']}", flush=True)  # fmt: skip
    if options.annotate:
        for line in annotate(data.lake, data.truths(), data.settings.rule, data.settings.seed):
            print(line, flush=True)
    print(json.dumps(counts_of(data.truths())), flush=True)


if __name__ == "__main__":
    main()
