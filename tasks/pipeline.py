"""The stages, in order. The one place that says so; the graph follows from their declarations."""

from __future__ import annotations

from tasks import (
    annotation,
    candidates,
    captions,
    capture,
    comparison,
    evaluation,
    exports,
    fidelity,
    indexing,
    micro_scenes,
    navigation,
    optimization,
    rescans,
    robot,
    selection,
    training,
)
from tasks.stage import Stage

STAGES: tuple[Stage, ...] = (
    capture.STAGE,
    rescans.STAGE,
    captions.STAGE,
    indexing.STAGE,
    candidates.STAGE,
    selection.STAGE,
    annotation.STAGE,
    optimization.STAGE,
    micro_scenes.STAGE,
    navigation.STAGE,
    fidelity.STAGE,
    exports.STAGE,
    evaluation.STAGE,
    robot.STAGE,
    training.STAGE,
    comparison.STAGE,
)

SCENE_STAGES: tuple[Stage, ...] = tuple(stage for stage in STAGES if stage.grain == "scene")

MODULES: dict[str, str] = {stage.name: f"tasks.{stage.name}" for stage in STAGES}
"""Package of each stage: one stem per stage, the same in every room."""


def upstream(stage: Stage) -> tuple[Stage, ...]:
    """The stages whose rows `stage` reads as part of the same scene's run, in order."""
    tables = {*stage.reads, *stage.streams} - set(stage.history)
    return tuple(other for other in STAGES if tables & set(other.writes))
