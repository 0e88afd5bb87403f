"""Selection on what nobody trained on: the AWS small house, scanned virtually, with its authors' models as the library.

Which model an object is, the name of its node says. Ten candidates of each: what retrieval ranks first, and others by chance; the model
that was scanned is one of them.
"""

from __future__ import annotations

import dataclasses
import json
import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.dwellings.by_others import BY_OTHERS
from bench.realdata import HOUSE, HOUSE_VOXEL_M, MODELS
from bench.selection.data import CAPTURE, DataSettings, work
from bench.selection.lineups import SLOTS, Offered
from bench.selection.measures import MeasuredMethod, TrueSurface, measured_room, source_digest
from bench.selection.rooms import LIGHT, TrueModel
from bench.shelves import ShelvedModel, models_in
from flows.run.fingerprints import code_fingerprint, digest
from schemas.budget import BUDGET
from schemas.files import read_file, write_whole
from schemas.selection import SelectionOutcome
from tasks.candidates.request import CandidateRequest
from tasks.candidates.retrieval import Retrieval
from tasks.capture import scenes as capture
from tasks.capture.formats import find_scans
from tasks.containers import GLB_MAGIC
from tasks.geometry.meshes import load_glb, surface_of
from tasks.geometry.transforms import inverse, matrix
from tasks.library.search import SearchWeights
from tasks.scanner import scan_scene
from tasks.scanner.scenery import scenery_of
from tasks.stage import Blobs, Context
from warehouse.lake import Lake

RETRIEVED = 6
"""Candidates that retrieval ranks first; the others are drawn from the rest of the library."""

DATASET = "house"


def lacking(realdata: Path | None) -> str | None:
    """Why the house cannot be measured; None where it can."""
    if realdata is None:
        return "METASCENES_REALDATA or --realdata names the folder that holds it"
    return None if BY_OTHERS[0].is_in(realdata) else f"{realdata} does not hold {HOUSE} and {MODELS}"


def model_of(node: str) -> str:
    """Model that an object of the house is a copy of: `ChairA_01_003` is the third `ChairA_01`."""
    return re.sub(r"_\d{3}$", "", node)


def house_outcomes(realdata: Path, folder: Path, scorers: Sequence[MeasuredMethod], seed: int) -> list[SelectionOutcome]:
    """Outcomes of every scorer for the objects of the house; the house is scanned once, and remembered in a folder."""
    lake, truth = made_house(realdata, folder / "house", seed)
    surfaces = _surfaces(realdata, truth)
    return measured_room(lake, lake.snapshot(), truth, surfaces, scorers, "AWS small house", folder / "measured", seed)


def made_house(realdata: Path, folder: Path, seed: int) -> tuple[Lake, dict[str, Any]]:
    """A lake with the house and its lineups, and its truth."""
    lake, path = Lake.open(folder / "lake"), folder / "truth.json"
    code = [code_fingerprint(module) for module in ("tasks.scanner", "tasks.capture.scenes", "tasks.selection")]
    mark = digest(BY_OTHERS[0].digest(realdata), source_digest("foreign", "data"), *code, str(seed))
    if path.exists() and (held := json.loads(path.read_bytes()))["mark"] == mark:
        return lake, held["truth"]
    with tempfile.TemporaryDirectory(prefix="house-", ignore_cleanup_errors=True) as place:
        truth = _scanned(realdata, lake, Path(place), seed)
    lake.commit("the AWS small house")
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(path, json.dumps({"mark": mark, "truth": truth}).encode())
    return lake, truth


def _scanned(realdata: Path, lake: Lake, place: Path, seed: int) -> dict[str, Any]:
    """Scan the house, capture it and line candidates up; rows are left staged."""
    nodes = _nodes(realdata)
    config = dataclasses.replace(LIGHT, voxel_m=HOUSE_VOXEL_M)
    scanned = scan_scene([part for parts in nodes.values() for part in parts], place, HOUSE.stem, config, np.random.default_rng(seed))
    scan = find_scans(place / HOUSE.stem, dataset=DATASET)[0][0]
    captured = capture.run(scan=scan, context=Context(scan.scene_id, "capture", seed, Blobs()), config=CAPTURE)
    scene = dataclasses.replace(captured.rows["scenes"][0], scan_path=HOUSE.stem)
    captured.rows["scenes"] = [scene]
    moved = matrix(scene.alignment) @ inverse(matrix(scanned.alignment))
    shelf = models_in(realdata / MODELS)
    models = {model_of(model.stem.removeprefix("aws_") + "_000"): model for model in shelf}
    names = {str(obj.object_id): obj for obj in scanned.objects if obj.object_id is not None and model_of(obj.name) in models}
    true = {
        row.instance_id: TrueModel(obj.name, obj.category, nodes[obj.name], moved, obj.extents)
        for row in captured.rows["instances"]
        if not row.is_structure and (obj := names.get(row.source_id)) is not None
    }

    def offer(model: TrueModel, request: CandidateRequest, rng: np.random.Generator) -> list[Offered]:
        return house_lineup(models[model_of(model.name)], request, shelf, rng)

    seconds: dict[str, float] = {}
    known = work(
        lake, captured.rows, captured.blobs, true, offer, "test", DataSettings(seed), seconds, Retrieval(shelf[0].library, SearchWeights())
    )
    for value in known.values():
        value["is_held_out"] = False
        for slot in value["slots"]:
            if slot["kind"] == "scanned":
                slot["total"] = 0.0  # the house has it turned and stretched, and yet it is the model
    return {"scene_id": scene.scene_id, "room_id": scene.room_id, "index": 0, "split": "test", "moved": moved.tolist(),
            "instances": known, "cpu_seconds": seconds}  # fmt: skip


def house_lineup(own: ShelvedModel, request: CandidateRequest, models: Sequence[ShelvedModel], rng: np.random.Generator) -> list[Offered]:
    """Ten models of the library: the scanned one, the first that retrieval ranks, and others by chance; shuffled."""
    by_file = {model.file: model for model in models}
    ranked = [by_file[match.file] for match in request.ranking if match.file != own.file][:RETRIEVED]
    chosen = {own.file, *(model.file for model in ranked)}
    rest = [model for model in models if model.file not in chosen]
    more = [rest[int(k)] for k in rng.permutation(len(rest))[: SLOTS - len(chosen)]]
    offered = [Offered("scanned" if model is own else "other", model.made) for model in (own, *ranked, *more)]
    return [offered[int(k)] for k in rng.permutation(len(offered))]


def _nodes(realdata: Path) -> dict[str, list[Any]]:
    """Meshes of the house by object, in its frame [m]."""
    parts = load_glb(read_file(realdata / HOUSE, HOUSE.name, BUDGET.scene_bytes, magic=GLB_MAGIC), HOUSE.name)
    scenery = scenery_of(parts)
    nodes: dict[str, list[Any]] = {obj.name: [] for obj in scenery.objects}
    for part, obj in zip(parts, scenery.object_of, strict=True):
        nodes[scenery.objects[int(obj)].name].append(part)
    return nodes


def _surfaces(realdata: Path, truth: Mapping[str, Any]) -> dict[str, TrueSurface]:
    """The true surface of every instance, by instance."""
    nodes, moved = _nodes(realdata), np.array(truth["moved"])
    return {name: TrueSurface(surface_of(nodes[value["model"]]), moved) for name, value in truth["instances"].items()}
