"""All tables of the lake, in the order of the data path."""

from __future__ import annotations

from schemas import (
    annotation,
    candidates,
    captions,
    capture,
    evaluation,
    exports,
    fidelity,
    navigation,
    optimization,
    runs,
    selection,
    training,
)
from schemas.record import Table, table_of

RECORDS: tuple[type, ...] = (
    capture.Scene,
    capture.Shell,
    capture.Room,
    capture.RoomSurface,
    capture.Frame,
    capture.Instance,
    capture.Mask,
    captions.Caption,
    candidates.Candidate,
    candidates.Asset,
    selection.Selection,
    annotation.WorkBatch,
    annotation.Assignment,
    annotation.Annotation,
    annotation.AnnotationFigures,
    annotation.Submission,
    annotation.SampledAnswer,
    annotation.AnswerVerdict,
    annotation.QualityReview,
    optimization.Placement,
    optimization.Support,
    optimization.Contact,
    optimization.OptimizationStep,
    optimization.Optimization,
    optimization.Certificate,
    navigation.Navmesh,
    navigation.Episode,
    navigation.UnreachableTarget,
    navigation.Split,
    fidelity.Fidelity,
    fidelity.SceneFidelity,
    exports.ExportFile,
    exports.ExportCheck,
    evaluation.Trajectory,
    training.LearnedModel,
    training.TrainingStep,
    training.ModelEvaluation,
    runs.StageRun,
    runs.Snapshot,
    runs.Release,
)

TABLES: dict[str, Table] = {table_of(record).name: table_of(record) for record in RECORDS}
