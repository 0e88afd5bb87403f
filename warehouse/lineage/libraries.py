"""The walk from what was found in a library: which library, which file, who made it and under which license."""

from __future__ import annotations

from typing import Any

from schemas.candidates import Candidate
from schemas.indexing import LibraryModel
from schemas.record import arrow_to_rows
from warehouse.lineage.walk import Walk, picked


def follow_library(walk: Walk, source: str, row: Candidate, depth: int) -> None:
    """An edge to the model of a library that a candidate was found as; nothing where it was made.

    A library may be removed, or indexed again, and what was taken from it stays: that is no gap, and the node says so.
    """
    if row.library_file is None:
        return
    facts: dict[str, Any] = {"library": row.library, "file": row.library_file, "score": row.library_score, "is_indexed": None}
    if row.library is not None:
        listed = walk.reader.matching("library_models", {"library": [row.library], "file": [row.library_file]})
        models = [model for model in arrow_to_rows(listed, LibraryModel) if model.asset_id == row.asset_id]
        facts["is_indexed"] = bool(models)
        for model in models:
            facts |= picked(
                model, "format", "unit_m", "unit_known", "up", "up_known", "category", "category_known", "license", "is_noncommercial",
                "author", "source_url", "content", "notes",
            )  # fmt: skip
    walk.leads(depth, source, walk.node("library_model", f"{row.library or 'folder'}/{row.library_file}", facts), "found as")
