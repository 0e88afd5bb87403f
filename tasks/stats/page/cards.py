"""What the report says of single scenes: a card each, and one table of many."""

from __future__ import annotations

import base64
import dataclasses
import re
from collections.abc import Callable, Mapping
from typing import Any

import pyarrow as pa

from tasks.stats.grids import OBJECT_LIMIT, Cell, Format, Grid, as_box, as_count, as_number, as_percent, as_share, as_text, grid
from tasks.stats.page.inline import inlined
from tasks.stats.scenes import ScenePictures
from tasks.stats.style import Picture


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

    curve, plan, heat: SVG of the loss curve, of the floor plan and of the heat map, where there are any. remains: what could not be
    put right.
    """

    scene_id: str
    anchor: str
    facts: tuple[tuple[str, str], ...]
    pictures: tuple[PicturePair, ...]
    excuse: str
    curve: str
    plan: str
    heat: str
    certificate: Grid
    remains: tuple[str, ...]
    objects: Grid


def anchor_of(scene_id: str) -> str:
    """Where the card of a scene is in the report."""
    return "scene-" + re.sub(r"[^A-Za-z0-9_-]", "-", scene_id)


def scene_card(scene_id: str, pictures: ScenePictures | str, answers: Mapping[str, pa.Table]) -> SceneCard:
    """One scene's card. `answers`: rows by name of the report's query."""
    objects = grid(
        f"Objects of {scene_id}",
        "scene_objects",
        of_scene(answers["scene_objects.pictured"], scene_id),
        [
            ("instance_id", "Instance", as_text),
            ("category", "Category", as_text),
            ("box_size", "Size [m]", as_box),
            ("mass_kg", "Mass [kg]", as_number),
            ("material", "Material", as_text),
            ("provider", "Provider", as_text),
            ("score", "Score", as_number),
            ("displacement_m", "Moved [m]", as_number),
            ("lift_m", "Lifted [m]", as_number),
            ("support", "Carried by", as_text),
            ("settled_displacement_m", "Settles [m]", as_number),
        ],
        limit=OBJECT_LIMIT,
    )
    curve, plan, heat = (pictures.loss_curve, pictures.plan, pictures.heat) if isinstance(pictures, ScenePictures) else (None,) * 3
    remains = of_scene(answers["optimization_remains.pictured"], scene_id).to_pylist()
    named = [" ".join(filter(None, (row["instance_id"], row["category"]))) for row in remains]
    return SceneCard(
        scene_id=scene_id,
        anchor=anchor_of(scene_id),
        facts=tuple(_facts(scene_id, answers)),
        pictures=tuple(_pairs(scene_id, pictures, answers)) if isinstance(pictures, ScenePictures) else (),
        excuse=as_text(pictures) if isinstance(pictures, str) else "",
        curve=_svg(curve),
        plan=_svg(plan),
        heat=_svg(heat),
        certificate=_certificate(scene_id, answers),
        remains=tuple(as_text(f"{name}: {row['remains']}" if name else row["remains"]) for name, row in zip(named, remains, strict=True)),
        objects=objects,
    )


def _svg(picture: Picture | None) -> str:
    return inlined(picture) if picture is not None else ""


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
        rows = of_scene(answers["collision_loss.listed"], scene_id).to_pylist()
        before, after = (rows[0][f"deep_pairs_{when}"] for when in ("before", "after")) if rows else (0, 0)
        title = f"Pairs deeper than 2 mm: {as_count(before)} as proposed, {as_count(after)} as optimized"
        views.append((title, "with what collides marked", ("Proposed", "Optimized"), pictures.before, pictures.after))
    return [
        PicturePair(
            title,
            names,
            (data_address(left, "image/jpeg"), data_address(right, "image/jpeg")),
            (f"{names[0]} of {scene_id} seen {where}", f"{names[1]} of {scene_id} seen {where}"),
        )
        for title, where, names, left, right in views
    ]


def _certificate(scene_id: str, answers: Mapping[str, pa.Table]) -> Grid:
    """The certificate's figures of a scene, one column per engine."""
    rows = of_scene(answers["stability.listed"], scene_id).to_pylist()
    categories = {row["instance_id"]: row["category"] for row in of_scene(answers["scene_objects.pictured"], scene_id).to_pylist()}

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
        ("Free ones within 1 cm and 5\u00b0", lambda row: share(row["stable_1cm"], row["free"])),
        ("Free ones within 5 cm and 5\u00b0", lambda row: share(row["stable_5cm"], row["free"])),
        (
            "The same after nudges, within 1 cm",
            lambda row: "\u2013" if row["stable_nudged"] is None else share(row["stable_nudged"], row["free"]),
        ),
        ("Moves most", worst),
        ("Tilts most", lambda row: "\u2013" if row["worst_tilt_degrees"] is None else f"{as_number(row['worst_tilt_degrees'])}\u00b0"),
        ("Deepest start of a free one", lambda row: depth(row["deepest_start_penetration_m"])),
        ("Could not be simulated", lambda row: as_count(row["refused"])),
        ("Without a certificate", lambda row: as_count(row["uncertified"])),
    ]
    headers = (Cell("Left alone under gravity", False), *(Cell(f"{row['engine']} {row['engine_version']}", True) for row in rows))
    cells = tuple((Cell(name, False), *(Cell(form(row), True) for row in rows)) for name, form in lines) if rows else ()
    return Grid(f"Certificate of {scene_id}", "stability", headers, cells, 0)


def _facts(scene_id: str, answers: Mapping[str, pa.Table]) -> list[tuple[str, str]]:
    """Name and value of what is known of a scene."""
    facts: list[tuple[str, str]] = []

    def add(view: str, column: str, name: str, form: Format) -> None:
        rows = of_scene(answers[view], scene_id)
        values = [value for value in rows[column].to_pylist() if value is not None]
        if values:
            facts.append((name, form(values[0])))

    add("objects_per_scene.listed", "room_type", "Room", as_text)
    add("objects_per_scene.listed", "floor_area_m2", "Floor [m²]", as_number)
    add("objects_per_scene.listed", "objects", "Objects", as_count)
    add("categories_per_scene.listed", "categories", "Categories", as_count)
    for row in of_scene(answers["collision_loss.listed"], scene_id).to_pylist():
        facts.append(("Deep pairs", f"{as_count(row['deep_pairs_before'])} \u2192 {as_count(row['deep_pairs_after'])}"))
    for row in of_scene(answers["stability.listed"], scene_id).to_pylist()[:1]:
        if row["free"]:
            facts.append(("Stable at 5 cm", f"{as_share(row['stable_5cm_share'])} ({as_share(row['fixed_share'])} fixed)"))
    add("scene_fidelity_overview.listed", "object_f_5cm", "F-score at 5 cm", as_number)
    add("navigability.listed", "navigable_share", "Navigable", as_percent)
    add("navigability.listed", "episodes", "Episodes", as_count)
    for row in of_scene(answers["export_verdicts.pictured"], scene_id).to_pylist():
        verdict = "passes" if row["passed"] else f"{row['broken_rules']} of {row['rules']} rules broken"
        facts.append((f"Export {row['format']}", verdict))
    add("scene_timing.listed", "total_seconds", "Computed [s]", as_number)
    return facts


def scene_table(answers: Mapping[str, pa.Table], total: int) -> Grid:
    """One row for every scene that is listed, of `total`."""
    rows = {row["scene_id"]: dict(row) for row in answers["objects_per_scene.listed"].to_pylist()}
    for view, columns in (
        ("categories_per_scene", ("categories",)),
        ("collision_loss", ("deep_pairs_before", "deep_pairs_after")),
        ("stability", ("fixed_share", "stable_1cm_share", "stable_5cm_share")),
        ("scene_fidelity_overview", ("object_f_5cm",)),
        ("navigability", ("navigable_share", "episodes")),
        ("scene_timing", ("total_seconds",)),
    ):
        for row in reversed(answers[f"{view}.listed"].to_pylist()):  # of several agents or engines the first one stays
            if row["scene_id"] in rows:
                rows[row["scene_id"]].update({column: row[column] for column in columns})
    shown: list[tuple[str, str, Format]] = [
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
        ("object_f_5cm", "F-score at 5 cm", as_number),
        ("navigable_share", "Navigable", as_percent),
        ("episodes", "Episodes", as_count),
        ("total_seconds", "Computed [s]", as_number),
    ]
    table = pa.table({name: [row.get(name) for row in rows.values()] for name, _, _ in shown})
    return grid("All scenes", "objects_per_scene", table, shown, total)


def of_scene(rows: pa.Table, scene_id: str) -> pa.Table:
    """Rows of one scene."""
    import pyarrow.compute as pc

    return rows.filter(pc.equal(rows["scene_id"], scene_id))


def data_address(content: bytes, kind: str) -> str:
    """A file as an address that needs no network."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
