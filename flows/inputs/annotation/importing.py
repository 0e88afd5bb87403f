"""Answers and reviews that others wrote, into the lake: all of a file or nothing of it."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from flows.inputs.annotation.acts import STAGE, Change, changing, now, rows_of, same_rows, state_in
from flows.run.configuration import Configuration, configure
from flows.run.fingerprints import ModuleCaches
from schemas.annotation import Annotation, AnnotationFigures, Assignment, QualityReview, Submission, WorkBatch
from schemas.budget import BUDGET
from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Scene, Shell
from schemas.errors import InputError
from schemas.selection import Selection
from schemas.wording import counted, noun
from tasks.annotation import AnnotationBatch, BatchActs, ReviewBatch, check_reviews, read_batch, read_reviews
from tasks.annotation.batch import read_answers
from tasks.annotation.cvat import read_cvat
from tasks.annotation.exported import accounts_of
from tasks.annotation.label_studio import read_label_studio
from tasks.annotation.quality import pass_interval
from tasks.annotation.revisions import latest, revised
from tasks.annotation.scan2cad import read_scan2cad
from tasks.batches import parse_json, read_limited
from tasks.stage import Context
from warehouse.lake import Lake
from warehouse.tables.gate import BatchState, demands, handed_in_hashes, passes, person
from warehouse.tables.snapshot import Reader

SCAN2CAD_RELEASED = datetime(2019, 6, 16, tzinfo=UTC)
"""When Scan2CAD was published: its file does not say when its answers were given."""

EXPORTS = {"label-studio": read_label_studio, "cvat": read_cvat}
"""Readers of what other annotation tools export, by what the tools are called."""

Check = Callable[[Reader], None]
"""Looks at a snapshot, and raises where nothing may be held against it."""


def import_annotations(lake: Lake, file: Path, dry_run: bool = False, configuration: Configuration | None = None) -> dict[str, Any]:
    """Read a batch, hold it against the lake's scenes and against what was assigned, and add what is new in it.

    Returns what was imported, as plain values: `new` answers, `corrected` and `withdrawn` ones, `already` where the lake had all of them.

    Raises:
        InputError: the file, or an answer in it, cannot be used, or the batch takes no answers now; nothing is imported then.
    """
    return _taken_in(lake, read_batch(file), file.name, dry_run, configuration or configure())


def save_answers(
    lake: Lake, document: Any, name: str = "answers", configuration: Configuration | None = None, check: Check = lambda reader: None
) -> dict[str, Any]:
    """Answers as a JSON value of `batch.schema.json`, as a page hands them over: saved as `import_annotations` saves those of a file.

    `check` is given the snapshot that they are then held against, and may refuse it.

    Raises:
        InputError: as `import_annotations`.
    """
    return _taken_in(lake, read_answers(document, name), name, False, configuration or configure(), check)


def import_alignments(
    lake: Lake, file: Path, batch_id: str, annotator: str = "scan2cad", answered_at: datetime = SCAN2CAD_RELEASED, dry_run: bool = False,
    configuration: Configuration | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Alignments of Scan2CAD (`full_annotations.json`) as a batch made elsewhere. `left_out` of what is returned names, a line each, the
    scans that the lake has not and the models that are no candidate of the object where they are aligned.

    Raises:
        InputError: the file is not Scan2CAD's, none of it can be taken, or as `import_annotations`.
    """
    document = parse_json(read_limited(file, file.name, BUDGET.annotation_bytes), file.name)
    reader = lake.snapshot()
    aligned = read_scan2cad(
        document, file.name, batch_id, annotator, answered_at, reader.rows(Scene), reader.rows(Instance), reader.rows(Candidate),
        reader.rows(Asset),
    )  # fmt: skip
    if not aligned.document["annotations"]:
        why = aligned.left_out[0] if aligned.left_out else "it has no models"
        raise InputError(file.name, "aligned_models", f"none can be taken: {why}", "import the scans with a library of its models first")
    batch = read_answers(aligned.document, file.name)
    return _taken_in(lake, batch, file.name, dry_run, configuration or configure()) | {"left_out": list(aligned.left_out)}


def import_export(
    lake: Lake, file: Path, tool: str, annotators: Sequence[str] = (), dry_run: bool = False, configuration: Configuration | None = None
) -> dict[str, Any]:
    """Answers that one of `EXPORTS` exported. `annotators`: `ACCOUNT=NAME` for whom the tool calls otherwise, and `NAME` of who answered
    where the export names nobody. `left_out` of what is returned names, a line each, what no answer was taken from.

    Raises:
        InputError: the file is no such export, nobody can tell whose an answer is, or as `import_annotations`.
    """
    data = read_limited(file, file.name, BUDGET.annotation_bytes)
    exported = EXPORTS[tool](data, file.name, accounts_of(annotators))
    summary = _taken_in(lake, exported.batch, file.name, dry_run, configuration or configure())
    return summary | {"left_out": list(exported.left_out)}


def import_reviews(lake: Lake, file: Path, dry_run: bool = False, configuration: Configuration | None = None) -> dict[str, Any]:
    """Read reviews of an annotation batch, hold them against its answers, and append those that are new.

    Returns what was imported, as plain values: `already` counts the reviews that the lake had.

    Raises:
        InputError: the file, or a review in it, cannot be used, or its batch is not in the lake; nothing is imported then.
            A review that is in the lake already and says something else is refused: reviews are history. So is one that accepts a
            batch whose sample is reviewed here, answer by answer.
    """
    batch, configuration = read_reviews(file), configuration or configure()
    if dry_run:
        return _reviewed(lake, lake.snapshot(), None, batch, configuration)
    with changing(lake, batch.batch_id) as change:
        return _reviewed(lake, change.reader, change, batch, configuration)


def _taken_in(
    lake: Lake, batch: AnnotationBatch, name: str, dry_run: bool, configuration: Configuration, check: Check = lambda reader: None
) -> dict[str, Any]:
    if dry_run:
        return _answered(lake, lake.snapshot(), None, batch, name, configuration)
    with changing(lake, batch.batch_id) as change:
        check(change.reader)
        return _answered(lake, change.reader, change, batch, name, configuration)


@dataclasses.dataclass(frozen=True)
class Answered:
    """Answers held against a lake. `given`: rows of all of them; `new`: those that the lake's batch, `present`, has not."""

    state: BatchState
    present: tuple[Annotation, ...]
    given: tuple[Annotation, ...]
    new: tuple[Annotation, ...]


def held_against(reader: Reader, batch: AnnotationBatch, name: str, configuration: Configuration) -> Answered:
    """Answers as rows, held against the scenes, the assignments and the state of their batch in a snapshot. Nothing is written.

    Raises:
        InputError: an answer cannot be used, or the batch takes none now.
    """
    state = state_in(reader, batch.batch_id)
    if state.origin == "created":
        _refuse_unassigned(batch, rows_of(reader, Assignment, batch.batch_id))
    instances: list[Instance] = [row for scene in batch.scene_ids for row in reader.rows(Instance, scene)]
    candidates: list[Candidate] = [row for scene in batch.scene_ids for row in reader.rows(Candidate, scene)]
    given: list[Annotation] = STAGE.run(
        annotation_batch=batch, review_batch=None, batch_acts=None, instances=instances, candidates=candidates,
        context=Context(scene_id=batch.batch_id, stage=STAGE.name, seed=configuration.seed, blobs={}),
        config=configuration.stages[STAGE.name],
    ).rows["annotations"]  # fmt: skip
    places = {(answer.scene_id, answer.instance_id, answer.annotator): (answer.source_file, answer.where) for answer in batch.annotations}
    present = rows_of(reader, Annotation, batch.batch_id)
    new = revised(present, given, places, batch.is_dated)
    if new and present:
        state.after("answer", name)
    return Answered(state, tuple(present), tuple(given), tuple(new))


def _answered(
    lake: Lake, reader: Reader, change: Change | None, batch: AnnotationBatch, name: str, configuration: Configuration
) -> dict[str, Any]:
    """Add the answers of a batch that the lake has not; without a `change`, only say which."""
    held = held_against(reader, batch, name, configuration)
    state, given, new = held.state, held.given, held.new
    acts = _acts(state, held.present, new, configuration)
    summary = {
        "batch_id": batch.batch_id,
        "annotations": len(given),
        "annotators": len({row.annotator for row in given}),
        "scenes": len(batch.scene_ids),
        "already": not new and acts == BatchActs(),
        "new": sum(row.revision == 1 for row in new),
        "corrected": sum(row.revision > 1 and not row.is_withdrawn for row in new),
        "withdrawn": sum(row.is_withdrawn for row in new),
    }
    if change is not None and not summary["already"]:
        acts = dataclasses.replace(acts, annotation_figures=tuple(_figures(lake, reader, new, held.present)))
        change.commit(acts, f"annotation batch {batch.batch_id}", configuration, name)
        state = state_in(lake.snapshot(), batch.batch_id)
    return summary | {"state": state.state, "counts": state.counts}


def _acts(state: BatchState, present: Sequence[Annotation], new: Sequence[Annotation], configuration: Configuration) -> BatchActs:
    """Rows that new answers add to a batch. One that was made elsewhere is handed in by being imported."""
    acts = BatchActs(annotations=tuple(new))
    if state.origin == "created":
        return acts
    config = configuration.stages[STAGE.name]
    counts = config.unreviewed_imports_count
    has_changed = state.batch is not None and counts != state.batch.counts_unreviewed
    if not new and not has_changed and (state.batch is not None or not counts):
        return acts
    whole = latest([*present, *new])
    # that of the last answer, withdrawn or not, and not that of the import: the same file gives the same bytes
    moment = max(row.answered_at for row in [*present, *new])
    if state.batch is not None:  # what its review demands stays as it was when the batch came in
        batch = dataclasses.replace(state.batch, counts_unreviewed=counts)
    else:
        batch = WorkBatch(
            batch_id=state.batch_id,
            origin="elsewhere",
            created_at=moment,
            pick=None,
            overlap=None,
            seed=configuration.seed,
            sample_share=config.sample_share,
            least_sample=config.least_sample,
            pass_share=config.pass_share,
            counts_unreviewed=counts,
        )
    if not new and state.handed_in:
        return dataclasses.replace(acts, annotation_batches=(batch,))
    number = state.round + 1 if present and new else 1
    submissions = tuple(
        Submission(
            batch_id=state.batch_id,
            round=number,
            scene_id=row.scene_id,
            instance_id=row.instance_id,
            annotator=row.annotator,
            revision=row.revision,
            answers=len(whole),
            submitted_by="import",
            submitted_at=moment,
        )
        for row in whole.values()
    )
    return dataclasses.replace(acts, annotation_batches=(batch,), submissions=submissions)


def _refuse_unassigned(batch: AnnotationBatch, assignments: Sequence[Assignment]) -> None:
    """Refuse answers to what was not asked, or not of who answers."""
    asked = {(row.scene_id, row.instance_id, row.annotator) for row in assignments}
    annotators, scenes = {row.annotator for row in assignments}, {row.scene_id for row in assignments}
    for answer in batch.annotations:
        if (answer.scene_id, answer.instance_id, answer.annotator) in asked:
            continue
        field, problem = "instance_id", f"{answer.scene_id} {answer.instance_id} was not assigned to {answer.annotator}"
        if answer.annotator not in annotators:
            field, problem = "annotator", f"nothing was assigned to {answer.annotator}"
        elif answer.scene_id not in scenes:
            field, problem = "scene_id", f"no object of {answer.scene_id} was assigned to anybody"
        raise InputError(
            answer.source_file, f"{answer.where}.{field}", f"{problem} in batch {batch.batch_id}", "answer what the batch asks for"
        )


def _figures(lake: Lake, reader: Reader, new: Sequence[Annotation], present: Sequence[Annotation]) -> list[AnnotationFigures]:
    """What the guidelines say of new answers in figures, scene by scene; none where there is no geometry to hold them against."""
    from tasks.annotation.guidelines import figures

    rows: list[AnnotationFigures] = []
    before = latest(present).values()
    for scene in sorted({row.scene_id for row in new}):
        answers = [row for row in new if row.scene_id == scene]  # those that choose nothing, too: what they chose before stands no more
        shells, selections = reader.rows(Shell, scene), reader.rows(Selection, scene)
        chosen = {row.choice for row in (*answers, *before) if row.choice is not None and row.scene_id == scene}
        assets = reader.rows_by_key(Asset, {row.asset_id for row in selections} | chosen)
        if not assets or all(row.choice is None for row in answers):
            continue
        rest = [row for row in before if row.scene_id == scene]
        rows += figures(answers, reader.rows(Instance, scene), selections, shells, assets, lake.blobs, ModuleCaches(), rest)
    return rows


def _reviewed(lake: Lake, reader: Reader, change: Change | None, batch: ReviewBatch, configuration: Configuration) -> dict[str, Any]:
    """Add the reviews of a file that the lake has not; without a `change`, only say which."""
    state = state_in(reader, batch.batch_id)
    answers = latest(rows_of(reader, Annotation, batch.batch_id))
    check_reviews(batch, len(answers))
    context = Context(scene_id=batch.batch_id, stage=STAGE.name, seed=configuration.seed, blobs=lake.blobs)
    rows: list[QualityReview] = STAGE.run(
        annotation_batch=None, review_batch=batch, batch_acts=None, instances=(), candidates=(), context=context,
        config=configuration.stages[STAGE.name],
    ).rows["quality_reviews"]  # fmt: skip
    where = {review.review_id: f"reviews[{index}]" for index, review in enumerate(batch.reviews)}
    present = {row.review_id: row for row in rows_of(reader, QualityReview, batch.batch_id)}
    new = []
    for row in rows:
        before = present.get(row.review_id)
        if before is None:
            new.append(_review_row(row, state, answers, batch.source_file, where[row.review_id]))
        elif not same_rows([_as_given(before)], [_as_given(row)]):
            problem = f"{row.review_id} of batch {batch.batch_id} is in the lake and says something else"
            raise InputError(batch.source_file, "review_id", problem, "give the new review a review_id of its own")
    if change is not None and new:
        note = f"review of annotation batch {batch.batch_id}"
        change.commit(BatchActs(quality_reviews=tuple(new)), note, configuration, batch.source_file)
    return {
        "batch_id": batch.batch_id,
        "reviews": len(rows),
        "already": len(rows) - len(new),
        "sampled": sum(row.sampled for row in rows),
        "wrong": sum(row.wrong for row in rows),
        "returned": sum(row.verdict == "returned" for row in rows),
    }


def _review_row(
    row: QualityReview, state: BatchState, answers: Mapping[tuple[str, str, str], Annotation], file: str, where: str
) -> QualityReview:
    """A review with the round that it is of, what was handed in then, and how sure it is.

    Raises:
        InputError: the gate does not allow it.
    """
    if row.verdict == "accepted" and (state.origin == "created" or state.sample):
        problem = f"{state.batch_id} is accepted by the verdicts on its sample alone"
        raise InputError(file, f"{where}.verdict", problem, "judge the sampled answers: `metascenes annotate sample`")
    state.after("accept" if row.verdict == "accepted" else "return", file, f"{where}.verdict")
    if re.fullmatch(r"round-[0-9]+", row.review_id):
        raise InputError(file, f"{where}.review_id", f"{row.review_id} is what reviews made here are called", "give it another id")
    if row.reviewed_at > now():
        raise InputError(file, f"{where}.reviewed_at", "is in the future", "give the time when the review was finished")
    annotators = {person(annotator) for _, _, annotator in answers}
    own = [name.strip() for name in row.reviewer.split(",") if person(name) in annotators]
    if person(row.reviewer) in annotators:  # names may hold commas
        own = [row.reviewer]
    if row.verdict == "accepted" and own:
        raise InputError(file, f"{where}.reviewer", f"{own[0]} is an annotator of the batch", "let somebody else review it")
    share, passed = demands(state.batch)[2], row.sampled - row.wrong
    if row.verdict == "accepted" and not passes(passed, row.sampled, share):
        problem = f"{passed} of {counted(row.sampled, 'sampled answer')} {noun(passed, 'passes', 'pass')}, and more than {share:.0%} must"
        raise InputError(file, f"{where}.verdict", problem, "return the batch, with the verdict 'returned'")
    if state.round > 1 and row.reviewed_at < max(answer.answered_at for answer in answers.values()):
        problem = "is before the last of the answers was given"
        raise InputError(file, f"{where}.reviewed_at", problem, "review the corrected answers")
    low, high = pass_interval(row.sampled - row.wrong, row.sampled, len(answers))
    return dataclasses.replace(
        row,
        round=state.round,
        answers=len(answers),
        handed_in_hashes=handed_in_hashes(state.handed_in) if state.batch is not None else None,
        pass_low=low,
        pass_high=high,
    )


def _as_given(row: QualityReview) -> QualityReview:
    """What the file says of a review, without what the lake adds."""
    return dataclasses.replace(row, round=1, answers=None, handed_in_hashes=None, pass_low=None, pass_high=None)
