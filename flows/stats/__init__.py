"""The statistics: asks the views, pictures scenes, draws it all, writes the report; as a function and as a Prefect flow."""

from __future__ import annotations

from typing import Any

from flows.stats.queries import Answers, ShownScenes, answers_of, report_queries, shown_scenes
from flows.stats.report import STAGES, Written, draw_charts, stage_table, write_report
from flows.stats.scenes import picture_scene_of

__all__ = [
    "STAGES",
    "Answers",
    "ShownScenes",
    "Written",
    "answers_of",
    "draw_charts",
    "picture_scene_of",
    "report_queries",
    "shown_scenes",
    "stage_table",
    "write_report",
]


def __getattr__(name: str) -> Any:
    """`flows.stats.statistics`, the Prefect flow: it alone imports Prefect, so it is loaded when it is asked for."""
    if name == "statistics":
        from flows.stats.flow import statistics

        return statistics
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
