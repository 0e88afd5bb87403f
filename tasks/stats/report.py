"""The report: one HTML file with everything in it, for a browser without a network."""

from __future__ import annotations

import base64
import dataclasses
import re
from collections.abc import Mapping, Sequence

import pyarrow as pa

from tasks.stats.grids import (
    Format,
    Grid,
    as_box,
    as_count,
    as_number,
    as_percent,
    as_text,
    grid,
    report_grids,
)
from tasks.stats.scenes import ScenePictures
from tasks.stats.style import INK, MUTED, PAPER, SERIES, Picture


@dataclasses.dataclass(frozen=True)
class Query:
    """The SQL behind a number: a view of the lake."""

    name: str
    question: str
    note: str
    sql: str


@dataclasses.dataclass(frozen=True)
class ReportContent:
    """All that a report says.

    answers: Rows of every view, by name. scenes: Pictures by scene; a reason in their place where there are none.
    picture_size: Width and height of these pictures [px]. stages: Stages in the order of the data path.
    """

    answers: Mapping[str, pa.Table]
    queries: Sequence[Query]
    pictures: Sequence[Picture]
    scenes: Mapping[str, ScenePictures | str]
    picture_size: tuple[int, int]
    stages: Sequence[str]
    snapshot_id: int
    snapshot_time: str
    code_version: str


@dataclasses.dataclass(frozen=True)
class SceneCard:
    """What the report says of one scene. Pictures are data addresses; `excuse` stands where there are none."""

    scene_id: str
    anchor: str
    facts: tuple[tuple[str, str], ...]
    pictures: tuple[tuple[str, str, str, str, str], ...]
    excuse: str
    objects: Grid


def render_report(content: ReportContent) -> str:
    """The report as one HTML document. The same content gives the same text."""
    from importlib import resources

    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string((resources.files("tasks.stats") / "report.html.jinja").read_text(encoding="utf-8"))
    return template.render(
        tones={"ink": INK, "muted": MUTED, "paper": PAPER, **{tone.role: tone for tone in SERIES}},
        headline=_headline(content.answers["headline"]),
        cards=[_card(scene_id, pictures, content.answers) for scene_id, pictures in content.scenes.items()],
        all_scenes=_all_scenes(content.answers),
        pictures=[(picture, _data(picture.svg.encode(), "image/svg+xml")) for picture in content.pictures],
        grids=report_grids(content.answers, content.stages),
        queries=content.queries,
        snapshot_id=content.snapshot_id,
        snapshot_time=content.snapshot_time,
        code_version=content.code_version,
        picture_width=content.picture_size[0],
        picture_height=content.picture_size[1],
    )


def _headline(rows: pa.Table) -> list[tuple[str, str]]:
    """Numbers and what they count."""
    row = rows.to_pylist()[0]
    return [
        (as_count(row["scenes"]), "scene" if row["scenes"] == 1 else "scenes"),
        (as_number(row["floor_area_m2"]) + " m²", "floor"),
        (as_count(row["objects"]), "objects"),
        (as_count(row["categories"]), "categories"),
        (as_count(row["placed_objects"]), "placed assets"),
        (as_count(row["assets"]), "candidate assets"),
        (as_count(row["episodes"]), "episodes"),
        (f"{as_count(row['exports_passed'])} of {as_count(row['exports'])}", "exports pass all checks"),
        (as_count(row["failures"]), "failed stages"),
        (as_number(row["total_seconds"]) + " s", "computed"),
    ]


def _card(scene_id: str, pictures: ScenePictures | str, answers: Mapping[str, pa.Table]) -> SceneCard:
    """One scene's card."""
    shown: list[tuple[str, str, str, str, str]] = []
    if isinstance(pictures, ScenePictures):
        for title, where, scan, replica in (
            ("Corner view", "from above a corner, without the walls in front", pictures.corner_scan, pictures.corner_replica),
            ("Top view", "from above, without the ceiling", pictures.top_scan, pictures.top_replica),
        ):
            alts = [f"{what} of {scene_id} seen {where}" for what in ("Scan", "Replica")]
            shown.append((title, _data(scan, "image/jpeg"), alts[0], _data(replica, "image/jpeg"), alts[1]))
    objects = grid(
        f"Objects of {scene_id}",
        "scene_objects",
        _of_scene(answers["scene_objects"], scene_id),
        [
            ("instance_id", "Instance", as_text),
            ("category", "Category", as_text),
            ("box_size_m", "Size [m]", as_box),
            ("mass_kg", "Mass [kg]", as_number),
            ("material", "Material", as_text),
            ("provider", "Provider", as_text),
            ("score", "Score", as_number),
            ("displacement_m", "Moved [m]", as_number),
            ("lift_m", "Lifted [m]", as_number),
            ("support", "Carried by", as_text),
        ],
    )
    return SceneCard(
        scene_id=scene_id,
        anchor="scene-" + re.sub(r"[^A-Za-z0-9_-]", "-", scene_id),
        facts=tuple(_facts(scene_id, answers)),
        pictures=tuple(shown),
        excuse=as_text(pictures) if isinstance(pictures, str) else "",
        objects=objects,
    )


def _facts(scene_id: str, answers: Mapping[str, pa.Table]) -> list[tuple[str, str]]:
    """Name and value of what is known of a scene."""
    facts: list[tuple[str, str]] = []

    def add(view: str, column: str, name: str, form: Format) -> None:
        rows = _of_scene(answers[view], scene_id)
        values = [value for value in rows[column].to_pylist() if value is not None]
        if values:
            facts.append((name, form(values[0])))

    add("objects_per_scene", "room_type", "Room", as_text)
    add("objects_per_scene", "floor_area_m2", "Floor [m²]", as_number)
    add("objects_per_scene", "objects", "Objects", as_count)
    add("categories_per_scene", "categories", "Categories", as_count)
    losses = [row for row in _of_scene(answers["collision_loss"], scene_id).to_pylist() if row["loss_before_m3"] is not None]
    if losses:
        before, after = (as_number(losses[0][f"loss_{when}_m3"] * 1000) for when in ("before", "after"))
        facts.append(("Overlap [l]", f"{before} → {after}"))
    add("navigability", "navigable_share", "Navigable", as_percent)
    add("navigability", "episodes", "Episodes", as_count)
    for row in _of_scene(answers["export_verdicts"], scene_id).to_pylist():
        verdict = "passes" if row["passed"] else f"{row['broken_rules']} of {row['rules']} rules broken"
        facts.append((f"Export {row['format']}", verdict))
    add("scene_timing", "total_seconds", "Computed [s]", as_number)
    return facts


def _all_scenes(answers: Mapping[str, pa.Table]) -> Grid:
    """One row for every scene."""
    rows = {row["scene_id"]: dict(row) for row in answers["objects_per_scene"].to_pylist()}
    for view, columns in (
        ("categories_per_scene", ("categories",)),
        ("collision_loss", ("loss_before_m3", "loss_after_m3")),
        ("navigability", ("navigable_share", "episodes")),
        ("scene_timing", ("total_seconds",)),
    ):
        for row in reversed(answers[view].to_pylist()):  # of several agents the first one stays
            if row["scene_id"] in rows:
                rows[row["scene_id"]].update({column: row[column] for column in columns})
    for row in rows.values():
        for when in ("before", "after"):
            loss = row.get(f"loss_{when}_m3")
            row[f"loss_{when}_l"] = None if loss is None else 1000 * loss
    names = ["scene_id", "room_type", "floor_area_m2", "objects", "categories", "loss_before_l", "loss_after_l"]
    names += ["navigable_share", "episodes", "total_seconds"]
    table = pa.table({name: [row.get(name) for row in rows.values()] for name in names})
    return grid(
        "All scenes",
        "objects_per_scene",
        table,
        [
            ("scene_id", "Scene", as_text),
            ("room_type", "Room", as_text),
            ("floor_area_m2", "Floor [m²]", as_number),
            ("objects", "Objects", as_count),
            ("categories", "Categories", as_count),
            ("loss_before_l", "Overlap before [l]", as_number),
            ("loss_after_l", "Overlap after [l]", as_number),
            ("navigable_share", "Navigable", as_percent),
            ("episodes", "Episodes", as_count),
            ("total_seconds", "Computed [s]", as_number),
        ],
    )


def _of_scene(rows: pa.Table, scene_id: str) -> pa.Table:
    import pyarrow.compute as pc

    return rows.filter(pc.equal(rows["scene_id"], scene_id))


def _data(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
