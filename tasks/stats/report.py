"""The report: one HTML file with everything in it, for a browser without a network."""

from __future__ import annotations

import base64
import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pyarrow as pa

from tasks.stats.grids import (
    Cell,
    Format,
    Grid,
    as_box,
    as_count,
    as_number,
    as_percent,
    as_share,
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
class PicturePair:
    """Two pictures from the same camera, as data addresses, each with its name and what is to be seen."""

    title: str
    names: tuple[str, str]
    addresses: tuple[str, str]
    alts: tuple[str, str]


@dataclasses.dataclass(frozen=True)
class SceneCard:
    """What the report says of one scene. `excuse` stands where there are no pictures.

    curve, plan: address of the loss curve and of the floor plan, and what is to be seen. remains: what could not be put right.
    """

    scene_id: str
    anchor: str
    facts: tuple[tuple[str, str], ...]
    pictures: tuple[PicturePair, ...]
    excuse: str
    curve: tuple[str, str] | None
    plan: tuple[str, str] | None
    certificate: Grid
    remains: tuple[str, ...]
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
        (
            f"{as_count(row['stable_5cm'])} of {as_count(row['free_objects'])}",
            f"free objects stable at 5 cm; {as_count(row['fixed_objects'])} fixed",
        ),
        (as_count(row["deep_pairs"]), "pairs deeper than 2 mm"),
        (as_count(row["episodes"]), "episodes"),
        (f"{as_count(row['exports_passed'])} of {as_count(row['exports'])}", "exports pass all checks"),
        (as_count(row["failures"]), "failed stages"),
        (as_number(row["total_seconds"]) + " s", "computed"),
    ]


def _card(scene_id: str, pictures: ScenePictures | str, answers: Mapping[str, pa.Table]) -> SceneCard:
    """One scene's card."""
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
            ("settled_displacement_m", "Settles [m]", as_number),
        ],
    )
    curve, plan = (pictures.loss_curve, pictures.plan) if isinstance(pictures, ScenePictures) else (None, None)
    remains = _of_scene(answers["optimization_remains"], scene_id).to_pylist()
    named = [" ".join(filter(None, (row["instance_id"], row["category"]))) for row in remains]
    return SceneCard(
        scene_id=scene_id,
        anchor="scene-" + re.sub(r"[^A-Za-z0-9_-]", "-", scene_id),
        facts=tuple(_facts(scene_id, answers)),
        pictures=tuple(_pairs(scene_id, pictures, answers)) if isinstance(pictures, ScenePictures) else (),
        excuse=as_text(pictures) if isinstance(pictures, str) else "",
        curve=(_data(curve.svg.encode(), "image/svg+xml"), curve.alt) if curve else None,
        plan=(_data(plan, "image/png"), f"Floor plan of {scene_id}: navmesh, footprints and paths of episodes") if plan else None,
        certificate=_certificate(scene_id, answers),
        remains=tuple(as_text(f"{name}: {row['remains']}" if name else row["remains"]) for name, row in zip(named, remains, strict=True)),
        objects=objects,
    )


def _pairs(scene_id: str, pictures: ScenePictures, answers: Mapping[str, pa.Table]) -> list[PicturePair]:
    """The pairs of pictures of a scene's card."""
    views = [
        (
            "Corner view",
            "from above a corner, without the walls in front",
            ("Scan", "Replica"),
            pictures.corner_scan,
            pictures.corner_replica,
        ),
        ("Top view", "from above, without the ceiling", ("Scan", "Replica"), pictures.top_scan, pictures.top_replica),
    ]
    if pictures.before is not None and pictures.after is not None:
        rows = _of_scene(answers["collision_loss"], scene_id).to_pylist()
        before, after = (rows[0][f"deep_pairs_{when}"] for when in ("before", "after")) if rows else (0, 0)
        title = f"Pairs deeper than 2 mm: {as_count(before)} as proposed, {as_count(after)} as optimized"
        views.append((title, "with what collides marked", ("Proposed", "Optimized"), pictures.before, pictures.after))
    return [
        PicturePair(
            title,
            names,
            (_data(left, "image/jpeg"), _data(right, "image/jpeg")),
            (f"{names[0]} of {scene_id} seen {where}", f"{names[1]} of {scene_id} seen {where}"),
        )
        for title, where, names, left, right in views
    ]


def _certificate(scene_id: str, answers: Mapping[str, pa.Table]) -> Grid:
    """The certificate's figures of a scene, one column per engine."""
    rows = _of_scene(answers["stability"], scene_id).to_pylist()
    categories = {row["instance_id"]: row["category"] for row in _of_scene(answers["scene_objects"], scene_id).to_pylist()}

    def share(count: int, of: int) -> str:
        return f"{as_count(count)} of {as_count(of)}" + (f", {as_share(count / of)}" if of else "")

    def depth(value: float | None) -> str:
        return "\u2013" if value is None else f"{as_number(1000 * value)} mm"

    def worst(row: Mapping[str, Any]) -> str:
        name = row["worst_instance_id"]
        if name is None:
            return "\u2013"
        return f"{name} {categories.get(name) or ''}".strip() + f", {as_number(100 * row['worst_displacement_m'])} cm"

    lines: list[tuple[str, Callable[[Mapping[str, Any]], str]]] = [
        ("Free to move", lambda row: share(row["free"], row["objects"])),
        ("Fixed", lambda row: share(row["fixed"], row["objects"])),
        ("Free ones within 1 cm", lambda row: share(row["stable_1cm"], row["free"])),
        ("Free ones within 5 cm and 5\u00b0", lambda row: share(row["stable_5cm"], row["free"])),
        ("Moves most", worst),
        ("Tilts most", lambda row: "\u2013" if row["worst_tilt_degrees"] is None else f"{as_number(row['worst_tilt_degrees'])}\u00b0"),
        ("Deepest start of a free one", lambda row: depth(row["deepest_start_penetration_m"])),
        ("Without a certificate", lambda row: as_count(row["uncertified"])),
    ]
    headers = (Cell("Left alone under gravity", False), *(Cell(f"{row['engine']} {row['engine_version']}", True) for row in rows))
    cells = tuple((Cell(name, False), *(Cell(form(row), True) for row in rows)) for name, form in lines) if rows else ()
    return Grid(f"Certificate of {scene_id}", "stability", headers, cells, 0)


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
    for row in _of_scene(answers["collision_loss"], scene_id).to_pylist():
        facts.append(("Deep pairs", f"{as_count(row['deep_pairs_before'])} \u2192 {as_count(row['deep_pairs_after'])}"))
    for row in _of_scene(answers["stability"], scene_id).to_pylist()[:1]:
        if row["free"]:
            facts.append(("Stable at 5 cm", f"{as_share(row['stable_5cm_share'])} ({as_share(row['fixed_share'])} fixed)"))
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
        ("collision_loss", ("deep_pairs_before", "deep_pairs_after")),
        ("stability", ("fixed_share", "stable_1cm_share", "stable_5cm_share")),
        ("navigability", ("navigable_share", "episodes")),
        ("scene_timing", ("total_seconds",)),
    ):
        for row in reversed(answers[view].to_pylist()):  # of several agents or engines the first one stays
            if row["scene_id"] in rows:
                rows[row["scene_id"]].update({column: row[column] for column in columns})
    names = ["scene_id", "room_type", "floor_area_m2", "objects", "categories", "deep_pairs_before", "deep_pairs_after"]
    names += ["fixed_share", "stable_1cm_share", "stable_5cm_share", "navigable_share", "episodes", "total_seconds"]
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
            ("deep_pairs_before", "Deep pairs before", as_count),
            ("deep_pairs_after", "Deep pairs after", as_count),
            ("fixed_share", "Fixed", as_percent),
            ("stable_1cm_share", "Stable at 1 cm", as_share),
            ("stable_5cm_share", "Stable at 5 cm", as_share),
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
