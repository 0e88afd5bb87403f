"""The flow that writes exports into a folder: `flows.exporting.export`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from prefect import flow
from prefect.artifacts import create_link_artifact
from prefect.states import Completed, Failed

from flows.outputs.export import write_exports
from flows.outputs.shipment import left_out_lines
from flows.run.parameters import Address
from flows.run.patience import patiently
from flows.server.artifacts import artifact_key, run_log, short_name
from schemas.errors import InputError
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.wording import counted
from warehouse.lake import Lake
from warehouse.release.licenses import Allowed

HOURS = 12
"""10,000 scenes are 70 GB of small files, checked one by one."""

if TYPE_CHECKING:
    Format = str
else:
    Format = Literal[EXPORT_FORMATS]  # the form of a run offers each

SHOWN = 20
"""Findings that a run's log names; the others are counted."""


def _name() -> str:
    from prefect.runtime import flow_run

    parameters = flow_run.parameters
    source = f"release {parameters['release']}" if parameters.get("release") else short_name(parameters["lake"])
    return f"{source} -> {short_name(parameters['out'])}"


@flow(name="export", flow_run_name=_name, persist_result=False, timeout_seconds=HOURS * 3600)
def export(
    lake: Address,
    out: Address,
    formats: list[Format] = [],  # noqa: B006
    scenes: list[str] = [],  # noqa: B006
    snapshot: int | None = None,
    release: str | None = None,
    licenses: list[str] = [],  # noqa: B006
    usdz: bool = False,
    workers: int | None = None,
) -> Any:
    """Write scenes as USD, Habitat dataset, MJCF, URDF, SDF, GLB and maps into a folder, and check what was written.

    The run fails when a check does, and where the allowed licenses leave nothing of a format.

    Args:
        lake: Address of the lake: a folder or s3://bucket/prefix.
        out: Folder to write into, on the machine that runs the flow.
        formats: Formats to write; all that the lake has by default.
        scenes: Only these scenes, by id.
        snapshot: Snapshot to export; the newest by default.
        release: Release to export, instead of a snapshot.
        licenses: Leave out what has another license: 'CC0-1.0', 'CC-BY-*', 'unknown'; all by default.
        usdz: Also pack every USD scene into one file.
        workers: Worker processes; one per core by default.
    """
    if "://" in out:
        raise InputError(out, "out", "is no folder", "name a folder of the machine that runs the flow")
    store = Lake.existing(lake)
    allowed = Allowed.parse(tuple(licenses)) if licenses else None
    place = Path(out)
    written = patiently(
        lambda: write_exports(
            store, place, formats, scenes, snapshot, release=release, usdz=usdz, allowed=allowed, workers=workers or os.cpu_count() or 1
        )
    )
    left_out = list(left_out_lines(written.shipment)) if written.shipment is not None else []
    text = f"{counted(written.files, 'file')} below {place}; {counted(written.failed_checks, 'check')} failed"
    run_log(text)
    for line in (*left_out, *written.notes[:SHOWN], *written.problems[:SHOWN]):
        run_log(line, warning=True)
    create_link_artifact(
        link=place.resolve().as_uri(), link_text=place.name, key=artifact_key("export", lake), description="\n\n".join([text, *left_out])
    )
    return Failed(message=f"{text}: {written.problems[0]}") if written.problems else Completed(message=text)
