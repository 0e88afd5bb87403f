"""The export formats."""

from __future__ import annotations

from schemas.families.export_formats import EXPORT_FORMATS
from tasks.exports.format import ExportFormat
from tasks.families import members

FORMATS = members("tasks.exports", EXPORT_FORMATS, ExportFormat)
"""In the order in which they are written."""
