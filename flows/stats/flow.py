"""The flow that draws the statistics: `flows.stats.statistics`. What it draws is also left as Prefect artifacts, so that the
Prefect UI shows it: pictures as images in the artifact itself, figures as tables, and a link to the report.
"""

from __future__ import annotations

import base64
import io
import itertools
from pathlib import Path
from typing import Any

import pyarrow as pa
from prefect import flow
from prefect.artifacts import create_image_artifact, create_link_artifact, create_markdown_artifact, create_table_artifact

from flows.run.parameters import Address
from flows.server.artifacts import Ticker, link_of, public_address, short_name
from flows.stats.report import Written, write_report
from schemas.errors import InputError
from schemas.machine.scratch import temporary_folder
from schemas.text import page_text
from schemas.wording import counted
from tasks.stats.columns import GRIDS
from tasks.stats.grids import Grid, grid
from tasks.stats.style import Picture
from warehouse.lake import Lake
from warehouse.release import snapshot_of
from warehouse.storage.files import storage_at

PREFIX = "statistics"
"""Keys of all artifacts begin with it."""

TABLES = ("stage_timing", "scene_certificates", "selection_quality", "failures")
"""Views whose rows become table artifacts."""

IMAGE_WIDTH = 1000
"""Pixels; wider pictures are made smaller, and become JPEGs, so that an artifact stays a few hundred kB."""


def _name() -> str:
    """`statistics of lake`, and of which snapshot or release."""
    from prefect.runtime import flow_run

    parameters = flow_run.parameters
    which = parameters.get("release") or (f"snapshot {parameters['snapshot']}" if parameters.get("snapshot") else "")
    return f"statistics of {short_name(parameters['lake'])}" + (f", {which}" if which else "")


@flow(name="statistics", flow_run_name=_name, persist_result=False)
def statistics(
    lake: Address,
    snapshot: int | None = None,
    release: str | None = None,
    out: Address | None = None,
    pictures: str | None = None,
    workers: int | None = None,
) -> str:
    """Draw the statistics of a lake: the report, and artifacts of this run.

    Args:
        lake: Address of the lake: a folder or s3://bucket/prefix.
        snapshot: Snapshot to report on; the newest by default.
        release: Release to report on, instead of a snapshot.
        out: Report to write: a file or folder of the machine that runs the flow, or s3://bucket/name.html. By default it is
            beside the lake: `lake-report.html` for a lake `lake`.
        pictures: Folder that gets every picture as SVG and PNG, on the machine that runs the flow.
        workers: Worker processes; one per core by default.

    Returns:
        Where the report is.
    """
    store = Lake.open(lake)
    chosen = snapshot_of(store, release, snapshot)
    place = public_address(out or beside(store.address))
    ticker = Ticker(_key("progress"), f"Statistics of {public_address(lake)}")
    done = itertools.count(1)
    total = 0

    def expect(count: int) -> None:
        nonlocal total
        total = count

    try:
        with temporary_folder() as making:
            is_local = "://" not in place
            written = write_report(
                store, Path(place) if is_local else making / "report.html", chosen,
                pictures=Path(pictures) if pictures else None, rasters=True, workers=workers,
                advance=lambda name: ticker.advance(next(done), total, name), expect=expect,
            )  # fmt: skip
            if is_local:
                place = str(written.path.absolute())
            else:
                folder, _, name = place.rpartition("/")
                storage_at(folder).write(name, written.path.read_bytes())
        keys = leave_artifacts(written, place)
        ticker.finish(f"{place}, {counted(len(keys), 'artifact')}")
    finally:
        ticker.close()
    return place


def beside(lake: str) -> str:
    """Where the report of a lake lies by default: next to it, so that it outlives the working folder of a run.

    Raises:
        InputError: the lake is a whole bucket: nothing lies beside it.
    """
    folder, _, name = lake.rstrip("/").rpartition("/")
    if folder.endswith(":/"):
        raise InputError(lake, "out", "the lake is a whole bucket, there is no place beside it", "say where the report shall be")
    return f"{folder}/{name}-report.html"


def leave_artifacts(written: Written, address: str) -> list[str]:
    """Artifacts of a report that lies at an address, and their keys. Must be called inside a flow run."""
    about = f"Snapshot {written.snapshot_id}."
    create_link_artifact(link=link_of(address), link_text=address, key=_key("report"), description=f"The whole report. {about}")
    create_markdown_artifact(markdown=_summary(written), key=_key("summary"), description=about)
    keys = [_key("report"), _key("summary")]
    for view in TABLES:
        caption, columns = GRIDS[view]
        shown = grid(caption, view, written.answers.rows[view], columns, written.answers.totals.get(view))
        cut = f" First {len(shown.rows)} of {counted(shown.total, 'row')}." if len(shown.rows) < shown.total else ""
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
    return page_text("\n".join(["# Scene lake", "", "| what | how many |", "| --- | ---: |", *rows, "", "## Pictures", "", *shown]))


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
