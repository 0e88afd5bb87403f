"""The report: one HTML file with everything in it, for a browser without a network."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
from collections.abc import Mapping, Sequence

import pyarrow as pa

from schemas.text import page_text
from tasks.films.drives import DriveStill
from tasks.films.walks import WalkStrip
from tasks.stats.columns import report_grids
from tasks.stats.grids import Grid, as_count, as_number, as_text
from tasks.stats.page.cards import anchor_of, data_address, scene_card, scene_table
from tasks.stats.page.inline import inlined
from tasks.stats.scenes import ScenePictures
from tasks.stats.style import GRID, INK, MUTED, PAPER, SERIES, Picture
from tasks.stats.thumbnails import OBJECT_PX, SCENE_PX, CandidateStrip, CandidateTile, SceneTile


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

    answers: Rows by name of the query. totals: How many rows a view has of which only the first are there.
    scenes: Pictures by scene; a reason in their place where there are none. picture_size: Width and height of these pictures [px].
    tiles, strips: The galleries. walks, drives: Stills of walks and of carts, by policy and run. stages: In the order of the data path.
    releases: Names that the snapshot is released under. pages: Relative address of a scene's page in 3D, by scene.
    """

    answers: Mapping[str, pa.Table]
    totals: Mapping[str, int]
    queries: Sequence[Query]
    pictures: Sequence[Picture]
    scenes: Mapping[str, ScenePictures | str]
    tiles: Sequence[SceneTile]
    strips: Sequence[CandidateStrip]
    picture_size: tuple[int, int]
    stages: Sequence[str]
    snapshot_id: int
    snapshot_time: str
    releases: Sequence[str]
    code_version: str
    pages: Mapping[str, str] = dataclasses.field(default_factory=dict)
    walks: Sequence[WalkStrip] = ()
    drives: Sequence[DriveStill] = ()


def render_report(content: ReportContent) -> str:
    """The report as one HTML document. The same content gives the same text."""
    from importlib import resources

    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup

    def read(name: str) -> str:
        return (resources.files("tasks.stats.page") / name).read_text(encoding="utf-8")

    def fit_to_show(value: object) -> object:
        """Texts without control characters; what is HTML already is made without them."""
        return page_text(value) if isinstance(value, str) and not isinstance(value, Markup) else value

    environment = Environment(
        loader=FunctionLoader(read), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, finalize=fit_to_show,
    )  # fmt: skip
    grids = report_grids(content.answers, content.totals, content.stages)
    sections = _sections(content, grids)
    tones = {"ink": INK, "muted": MUTED, "grid": GRID, "paper": PAPER, **{tone.role: tone for tone in SERIES}}
    # Browsers hash what they parsed: a line feed right after <style> or <script> is part of it.
    style, script = environment.get_template("report.css.jinja").render(tones=tones), read("report.js")
    return environment.get_template("report.html.jinja").render(
        policy=Markup(_policy(style, script)),
        style=Markup(style),
        script=Markup(script),
        sections=sections,
        present={anchor for anchor, _ in sections},
        tones=tones,
        headline=_headline(content.answers["headline"]),
        cards=[scene_card(scene_id, pictures, content.answers) for scene_id, pictures in content.scenes.items()],
        all_scenes=scene_table(content.answers, content.answers["headline"]["scenes"][0].as_py()),
        tiles=[_scene_entry(tile, content.scenes) for tile in content.tiles],
        strips=[_strip_entry(strip) for strip in content.strips],
        walks=[(walk, data_address(walk.picture, "image/jpeg")) for walk in content.walks],
        drives=[(drive, data_address(drive.picture, "image/jpeg")) for drive in content.drives],
        scene_px=SCENE_PX,
        object_px=OBJECT_PX,
        pictures=[(picture, inlined(picture)) for picture in content.pictures],
        grids=grids,
        queries=content.queries,
        snapshot_id=content.snapshot_id,
        snapshot_time=content.snapshot_time,
        releases=content.releases,
        code_version=content.code_version,
        pages=content.pages,
        picture_width=content.picture_size[0],
        picture_height=content.picture_size[1],
    )


def _policy(style: str, script: str) -> str:
    """The content security policy of the page: its own style and script alone. Charts and bars have styles as attributes.

    Browsers that do not know `style-src-elem` take `style-src`.
    """
    return (
        f"default-src 'none'; img-src data:; script-src {_hash(script)}; style-src 'unsafe-inline'; style-src-elem {_hash(style)}; "
        "style-src-attr 'unsafe-inline'; base-uri 'none'; form-action 'none'"
    )


def _hash(text: str) -> str:
    """The name that a policy has for an inline script or style."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _sections(content: ReportContent, grids: Mapping[str, Grid]) -> list[tuple[str, str]]:
    """Anchor and name of each section that has something to say, in the order of the page."""
    scenes = content.answers["headline"]["scenes"][0].as_py()
    further = {
        "gallery": content.tiles,
        "scenes": content.scenes or scenes,
        "statistics": content.pictures,
        "selection": content.strips,
        "navigation": content.walks,
        "robot": content.drives,
    }
    return [
        (anchor, name)
        for anchor, (name, views) in _SECTIONS.items()
        if views is None or further.get(anchor) or any(grids[view].rows for view in views)
    ]


_SECTIONS: Mapping[str, tuple[str, Sequence[str] | None]] = {
    "gallery": ("Gallery", ()),
    "scenes": ("Scenes", ()),
    "statistics": ("Statistics", ("dataset_comparison",)),
    "time": ("Time", ("stage_timing", "annotation_timing")),
    "selection": ("Selection", ("selection_quality",)),
    "selection-methods": ("Selection methods", ("selection_methods",)),
    "annotation": ("Annotation", ("annotation_agreement", "annotator_agreement", "quality_history")),
    "plausibility": (
        "Plausibility",
        ("scene_certificates", "stability", "unstable_objects", "optimization_remains", "support_counts", "density_check"),
    ),
    "fidelity": ("Fidelity", ("scene_fidelity_overview", "fidelity_by_category")),
    "micro-scenes": ("Micro-scenes", ("micro_scene_overview", "synthesis_figures", "synthesis_evaluations")),
    "navigation": ("Navigation", ("navigability", "navigation_metrics", "navigation_comparison", "unreachable_objects")),
    "robot": ("Robot", ("robot_metrics",)),
    "exports": ("Exports", ("export_verdicts", "broken_rules")),
    "failures": ("Failures", None),
    "licenses": ("Licenses", ("license_counts", "attributions")),
    "citing": ("Citing", None),
    "sql": ("SQL", None),
}
"""Name of each section in the bar, and the views of its tables; None where it always has something to say."""


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
        (
            "\u2013" if row["median_object_f_5cm"] is None else as_number(row["median_object_f_5cm"]),
            "median F-score of scenes' objects at 5 cm",
        ),
        (as_count(row["episodes"]), "episodes"),
        (f"{as_count(row['exports_passed'])} of {as_count(row['exports'])}", "exports pass all checks"),
        (as_count(row["failures"]), "failed stages"),
        (as_number(row["total_seconds"]) + " s", "computed"),
    ]


def _scene_entry(tile: SceneTile, cards: Mapping[str, object]) -> dict[str, object]:
    """A scene of the gallery for the page."""
    return {
        "scene_id": tile.scene_id,
        "anchor": anchor_of(tile.scene_id) if tile.scene_id in cards else "",
        "excuse": as_text(tile.excuse),
        "views": [
            (data_address(file, "image/jpeg"), f"{name} of {tile.scene_id}, small")
            for name, file in (("Scan", tile.scan), ("Replica", tile.replica))
            if file is not None
        ],
    }


def _strip_entry(strip: CandidateStrip) -> dict[str, object]:
    """An object of the gallery for the page."""
    what = f"{strip.category} {strip.instance_id} of {strip.scene_id}"
    return {
        "category": strip.category,
        "scene_id": strip.scene_id,
        "instance_id": strip.instance_id,
        "choice": "".join(f", slot {tile.slot} chosen by {strip.origin or 'rank'}" for tile in strip.tiles if tile.is_chosen),
        "crop": data_address(strip.crop, "image/jpeg") if strip.crop is not None else "",
        "alt": f"The scan of {what}",
        "tiles": [{"tile": tile, "address": _address(tile), "alt": _in_words(tile, what)} for tile in strip.tiles],
    }


def _address(tile: CandidateTile) -> str:
    return data_address(tile.picture, "image/jpeg") if tile.picture is not None else ""


def _in_words(tile: CandidateTile, what: str) -> str:
    """A candidate in words."""
    facts = [f"score {tile.score:.3f}" if tile.score is not None else "not scored"]
    facts += ["chosen"] if tile.is_chosen else []
    facts += ["a fallback"] if tile.is_fallback else []
    return f"Candidate {tile.slot} for {what}: {tile.provider}, {', '.join(facts)}"
