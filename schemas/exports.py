"""Rows of the exports stage: files for simulators, and the checks that they passed."""

from __future__ import annotations

from schemas.families.export_formats import EXPORT_FORMATS
from schemas.record import SCENE_PATTERN, column, record


@record("export_files", key=("scene_id", "format", "path"), stage="exports")
class ExportFile:
    """A file of a scene's export. `metascenes export` lays these out in a folder."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    format: str = column("Format", values=EXPORT_FORMATS)
    path: str = column("Path relative to the export's root, forward slashes")
    file_blob: str = column("Contents", blob=True)
    size_bytes: int = column("Size", unit="B", minimum=0)
    role: str = column(
        "What it is", values=("root", "scene", "stage", "object", "asset", "collision", "navmesh", "semantic", "episodes", "texture")
    )
    passed: bool = column("Verdict of the gate on the scene's export in this format; `export_checks` has it by rule")


@record("export_checks", key=("scene_id", "format", "rule"), stage="exports")
class ExportCheck:
    """The verdict of one rule on a scene's export."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    format: str = column("Format", values=EXPORT_FORMATS)
    rule: str = column("Rule")
    passed: bool = column("Verdict")
    message: str | None = column("What is wrong, when it did not pass")
