"""The flow that draws the statistics: `flows.stats.statistics`. What it draws is also left as Prefect artifacts, so that the
Prefect UI shows it: pictures as images in the artifact itself, figures as tables, and a link to the report.
"""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any

import pyarrow as pa
from prefect import flow
from prefect.artifacts import create_image_artifact, create_link_artifact, create_markdown_artifact, create_table_artifact

from flows.stats.report import Written, write_report
from tasks.stats.columns import GRIDS
from tasks.stats.grids import Grid, grid
from tasks.stats.style import Picture
from warehouse.lake import Lake
from warehouse.release import snapshot_of

PREFIX = "statistics"
"""Keys of all artifacts begin with it."""

TABLES = ("stage_timing", "scene_certificates", "selection_quality", "failures")
"""Views whose rows become table artifacts."""

IMAGE_WIDTH = 1000
"""Pixels; wider pictures are made smaller, and become JPEGs, so that an artifact stays a few hundred kB."""


@flow(name="statistics", persist_result=False)
def statistics(
    lake: str,
    snapshot: int | None = None,
    release: str | None = None,
    out: str = "report.html",
    pictures: str | None = None,
    workers: int | None = None,
) -> str:
    """Draw the statistics of a lake: the report, and artifacts of this run.

    Args:
        lake: Address of the lake: a folder or s3://bucket/prefix.
        snapshot: Snapshot to report on; the newest by default.
        release: Release to report on, instead of a snapshot.
        out: Report to write, on the machine that runs the flow.
        pictures: Folder that gets every picture as SVG and PNG.
        workers: Worker processes; one per core by default.

    Returns:
        Where the report is.
    """
    store = Lake.open(lake)
    written = write_report(
        store, Path(out), snapshot_of(store, release, snapshot), pictures=Path(pictures) if pictures else None, workers=workers
    )
    leave_artifacts(written)
    return str(written.path)


def leave_artifacts(written: Written) -> list[str]:
    """Artifacts of a report, and their keys. Must be called inside a flow run."""
    about = f"Snapshot {written.snapshot_id}."
    path = written.path.resolve()
    create_link_artifact(link=path.as_uri(), link_text=path.name, key=_key("report"), description=f"The whole report. {about}")
    create_markdown_artifact(markdown=_summary(written), key=_key("summary"), description=about)
    keys = [_key("report"), _key("summary")]
    for view in TABLES:
        caption, columns = GRIDS[view]
        shown = grid(caption, view, written.answers.rows[view], columns, written.answers.totals.get(view))
        cut = f" First {len(shown.rows)} of {shown.total} rows." if len(shown.rows) < shown.total else ""
        create_table_artifact(table=_records(shown), key=_key(view), description=f"{caption}. View `{view}`. {about}{cut}")
        keys.append(_key(view))
    for picture in written.pictures:
        key = _key(f"picture-{picture.name}")
        create_image_artifact(image_url=_address(picture), key=key, description=f"{picture.alt} View `{picture.source}`. {about}")
        keys.append(key)
    return keys


def _key(name: str) -> str:
    """Prefect's keys are lower case letters, digits and dashes."""
    return f"{PREFIX}-{name}".replace("_", "-").lower()


def _summary(written: Written) -> str:
    """The headline numbers as Markdown."""
    headline: pa.Table = written.answers.rows["headline"]
    rows = [f"| {name.replace('_', ' ')} | {_cell(value)} |" for name, value in headline.to_pylist()[0].items()]
    shown = [f"- {picture.title}: {picture.alt}" for picture in written.pictures]
    return "\n".join(["# Scene lake", "", "| what | how many |", "| --- | ---: |", *rows, "", "## Pictures", "", *shown])


def _cell(value: Any) -> str:
    return f"{value:,.1f}" if isinstance(value, float) else f"{value:,}"


def _records(shown: Grid) -> list[dict[str, str]]:
    headers = [cell.text for cell in shown.headers]
    return [{header: cell.text for header, cell in zip(headers, row, strict=True)} for row in shown.rows]


def _address(picture: Picture) -> str:
    """The picture as an address that needs no server: its PNG, or a smaller JPEG of a large one."""
    from PIL import Image

    data, kind = picture.png, "png"
    with Image.open(io.BytesIO(picture.png)) as image:
        if image.width > IMAGE_WIDTH:
            made = io.BytesIO()
            image.convert("RGB").resize((IMAGE_WIDTH, round(image.height * IMAGE_WIDTH / image.width))).save(made, "JPEG", quality=82)
            data, kind = made.getvalue(), "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
