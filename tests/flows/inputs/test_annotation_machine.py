"""Whatever people do to annotation batches, in whatever order: no answer that was returned, or that nobody reviewed, gets through."""

from __future__ import annotations

import json
import shutil
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from flows.inputs.annotation import BatchPlan, conclude, create_batch, draw_sample, import_reviews, save_answers, save_verdicts, submit
from flows.run.configuration import configure
from schemas.annotation import Annotation, AnswerVerdict, Assignment, QualityReview, SampledAnswer
from schemas.errors import InputError
from tests.annotated import SCENES, annotatable, answer
from tests.samples import START, fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.tables.gate import batch_states, handed_in_hashes
from warehouse.tables.reviews import standing_answers

Key = tuple[str, str, str]
SMALL = configure(settings=["annotation.least_sample=2"])
TRUSTING = configure(settings=["annotation.least_sample=1", "annotation.pass_share=0.1", "annotation.unreviewed_imports_count=true"])
"""What counts unreviewed, and would be reviewed with less care: that, a batch keeps as it came in."""

CREATED, ELSEWHERE = "made-here", "made-elsewhere"
NAMES = ("ada", "bob")
KEYS: tuple[Key, ...] = tuple((SCENES[0], f"{number:04d}", name) for number in (1, 2) for name in NAMES)


class Model:
    """What a batch is at, told by what was done to it alone."""

    def __init__(self, state: str) -> None:
        self.state = state
        self.revisions: dict[Key, list[bool]] = {}  # whether each revision is a withdrawal
        self.frozen: dict[Key, int] = {}
        self.sample: set[Key] = set()
        self.verdicts: dict[Key, bool] = {}
        self.last: list[dict[str, Any]] = []
        self.is_trusted = self.was_returned = False

    def answers(self) -> dict[Key, int]:
        return {key: len(rows) for key, rows in self.revisions.items() if rows and not rows[-1]}

    def hand_in(self) -> None:
        self.state, self.frozen, self.sample, self.verdicts = "submitted", self.answers(), set(), {}


class Gate(RuleBasedStateMachine):
    """A batch that was created and one that was made elsewhere, on one lake."""

    template: Path | None = None

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        if Gate.template is None:
            Gate.template = Path(tempfile.mkdtemp()) / "lake"
            lake = annotatable(Gate.template, objects=2, scenes=SCENES[:1])
            create_batch(lake, BatchPlan(CREATED, NAMES, 2), self.folder / "work", configuration=SMALL)
        shutil.copytree(Gate.template, self.folder / "lake")
        self.lake = Lake.open(self.folder / "lake")
        self.models = {CREATED: Model("open"), ELSEWHERE: Model("none")}
        self.hours, self.reviews = 0.0, 0

    @initialize(keys=st.sets(st.sampled_from(KEYS), min_size=1))
    def begin(self, keys: set[Key]) -> None:
        for batch in self.models:
            self._answers(batch, dict.fromkeys(keys, 1))

    def teardown(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)

    def _answers(self, batch: str, given: dict[Key, int | None], withdrawn: bool = False, trusts: bool = False) -> None:
        model = self.models[batch]
        self.hours += 1
        rows = [answer(*key, choice, at=self.hours) | ({"withdrawn": True} if withdrawn else {}) for key, choice in sorted(given.items())]
        before = self.lake.snapshot().snapshot_id
        may = model.state in ("open", "returned") if batch == CREATED else model.state in ("none", "submitted", "returned")
        if withdrawn:
            may = may and all(model.revisions.get(key) for key in given)
        if not may:
            with pytest.raises(InputError):
                save_answers(self.lake, {"batch_id": batch, "annotations": rows}, configuration=SMALL)
            assert self.lake.snapshot().snapshot_id == before
            return
        save_answers(self.lake, {"batch_id": batch, "annotations": rows}, configuration=TRUSTING if trusts else SMALL)
        model.last, model.is_trusted = rows, trusts
        for key in given:
            model.revisions.setdefault(key, []).append(withdrawn)
        if batch == ELSEWHERE and model.answers():
            model.hand_in()

    @rule(
        batch=st.sampled_from([CREATED, ELSEWHERE]), key=st.sampled_from(KEYS), choice=st.sampled_from([1, 2, None]), trusts=st.booleans()
    )
    def correct(self, batch: str, key: Key, choice: int | None, trusts: bool) -> None:
        self._answers(batch, {key: choice}, trusts=trusts)

    @rule(trusts=st.booleans())
    def import_again(self, trusts: bool) -> None:
        """The file that came last again, in whatever state, with another trust."""
        model = self.models[ELSEWHERE]
        save_answers(self.lake, {"batch_id": ELSEWHERE, "annotations": model.last}, configuration=TRUSTING if trusts else SMALL)
        model.is_trusted = trusts

    @rule(batch=st.sampled_from([CREATED, ELSEWHERE]), key=st.sampled_from(KEYS))
    def withdraw(self, batch: str, key: Key) -> None:
        self._answers(batch, {key: None}, withdrawn=True)

    @rule(batch=st.sampled_from([CREATED, ELSEWHERE]), partial=st.booleans())
    def hand_in(self, batch: str, partial: bool) -> None:
        model = self.models[batch]
        if batch == CREATED and model.state in ("open", "returned") and model.answers() and (partial or len(model.answers()) == len(KEYS)):
            submit(self.lake, batch, "ada", partial, SMALL)
            model.hand_in()
        else:
            with pytest.raises(InputError):
                submit(self.lake, batch, "ada", partial, SMALL)

    @rule(batch=st.sampled_from([CREATED, ELSEWHERE]))
    def draw(self, batch: str) -> None:
        model = self.models[batch]
        if model.state != "submitted":
            with pytest.raises(InputError):
                draw_sample(self.lake, batch, SMALL)
            return
        draw_sample(self.lake, batch, SMALL)
        number = max(row.round for row in self.lake.snapshot().rows(SampledAnswer) if row.batch_id == batch)
        rows = [row for row in self.lake.snapshot().rows(SampledAnswer) if (row.batch_id, row.round) == (batch, number)]
        model.state, model.sample = "in_review", {(row.scene_id, row.instance_id, row.annotator) for row in rows}
        assert len(model.sample) == min(2, len(model.frozen))
        assert all(model.frozen[row.scene_id, row.instance_id, row.annotator] == row.revision for row in rows)

    @rule(
        batch=st.sampled_from([CREATED, ELSEWHERE]),
        key=st.sampled_from(KEYS),
        passes=st.booleans(),
        reviewer=st.sampled_from(["rita", "Ada"]),
    )
    def judge(self, batch: str, key: Key, passes: bool, reviewer: str) -> None:
        model = self.models[batch]
        scene, instance, annotator = key
        verdict = {"scene_id": scene, "instance_id": instance, "annotator": annotator, "passes": passes, "remark": "low"}
        document = {"batch_id": batch, "reviewer": reviewer, "verdicts": [verdict | {"reviewed_at": START.isoformat()}]}
        if model.state == "in_review" and key in model.sample and reviewer.lower() != annotator:
            save_verdicts(self.lake, document, configuration=SMALL)
            model.verdicts[key] = passes
        else:
            with pytest.raises(InputError):
                save_verdicts(self.lake, document, configuration=SMALL)

    @rule(batch=st.sampled_from([CREATED, ELSEWHERE]))
    def judge_all(self, batch: str) -> None:
        """All that is drawn passes, by somebody else."""
        for key in sorted(self.models[batch].sample):
            self.judge(batch, key, True, "rita")

    @rule(batch=st.sampled_from([CREATED, ELSEWHERE]), passes=st.booleans())
    def go_on(self, batch: str, passes: bool) -> None:
        """What comes next for the batch: few orders of steps drawn at random lead to its end."""
        model = self.models[batch]
        if model.state in ("open", "returned"):
            self._answers(batch, dict.fromkeys(KEYS, 2))
            if batch == CREATED:
                self.hand_in(batch, False)
        elif model.state == "submitted":
            self.draw(batch)
        elif model.state == "in_review":
            for key in sorted(model.sample):
                self.judge(batch, key, passes, "rita")
            self.end(batch)

    @rule(batch=st.sampled_from([CREATED, ELSEWHERE]))
    def end(self, batch: str) -> None:
        model = self.models[batch]
        if model.state != "in_review" or model.verdicts.keys() != model.sample:
            with pytest.raises(InputError):
                conclude(self.lake, batch, SMALL)
            return
        verdict = conclude(self.lake, batch, SMALL)["verdict"]
        assert verdict == ("accepted" if all(model.verdicts.values()) else "returned"), "one of two is more than 2 %"
        model.state, model.was_returned = verdict, model.was_returned or verdict == "returned"

    @rule(batch=st.sampled_from([CREATED, ELSEWHERE]), verdict=st.sampled_from(["accepted", "returned"]))
    def review_from_elsewhere(self, batch: str, verdict: str) -> None:
        model = self.models[batch]
        self.reviews += 1
        moment = datetime.now(UTC).isoformat()
        row = {"review_id": f"file-{self.reviews}", "reviewer": "eve", "reviewed_at": moment, "sampled": 1, "wrong": 0, "verdict": verdict}
        file = self.folder / "review.json"
        file.write_text(json.dumps({"batch_id": batch, "reviews": [row]}))
        if batch == CREATED:
            may = verdict == "returned" and model.state in ("in_review", "accepted")
        else:
            may = verdict == "returned" or (not model.sample and model.state in ("submitted", "accepted", "returned"))
        if may and model.answers():
            import_reviews(self.lake, file, configuration=SMALL)
            model.state, model.was_returned = verdict, model.was_returned or verdict == "returned"
        else:
            with pytest.raises(InputError):
                import_reviews(self.lake, file, configuration=SMALL)

    @rule()
    def forge(self) -> None:
        """Rows that no command would write, in a copy of the lake, say that the batch that was created passed and was accepted."""
        model = self.models[CREATED]
        if model.state == "accepted" or (model.sample and model.verdicts.keys() == model.sample and all(model.verdicts.values())):
            return
        copy = Lake.open(shutil.copytree(self.lake.address, self.folder / "copy"))
        state = batch_states(copy.snapshot(), [CREATED])[CREATED]
        review = sample(
            QualityReview, batch_id=CREATED, review_id="forged", round=max(1, state.round), verdict="accepted", sampled=2, wrong=0,
            reviewed_at=START + timedelta(days=5000), handed_in_hashes=handed_in_hashes(state.handed_in),
        )  # fmt: skip
        by_themselves = [
            sample(
                AnswerVerdict, batch_id=CREATED, round=state.round, scene_id=scene, instance_id=instance, annotator=annotator,
                number=10**6, reviewer=annotator.upper(), passes=True,
            )
            for scene, instance, annotator in sorted(model.sample)
        ]  # fmt: skip
        rows: dict[str, list[Any]] = {"quality_reviews": [review], "answer_verdicts": by_themselves}
        copy.stage_rows(stage_run(CREATED, "annotation", fingerprint("forged")), rows)
        assert copy.commit(scenes=[CREATED]) is not None
        assert not batch_states(copy.snapshot(), [CREATED])[CREATED].counts
        assert CREATED not in standing_answers(copy.snapshot()).column("batch_id").to_pylist()
        shutil.rmtree(copy.address)

    @invariant()
    def only_what_was_accepted_stands(self) -> None:
        reader = self.lake.snapshot()
        states = batch_states(reader)
        standing = standing_answers(reader).to_pylist()
        for batch, model in self.models.items():
            if model.state == "none":
                continue
            assert states[batch].state == model.state, batch
            rows = {
                (row["scene_id"], row["instance_id"], row["annotator"]): row["revision"] for row in standing if row["batch_id"] == batch
            }
            withdrawn = {key for key, revisions in model.revisions.items() if revisions[-1]}
            trusted = batch == ELSEWHERE and model.is_trusted and not model.was_returned and model.state in ("submitted", "in_review")
            counts = model.state == "accepted" or trusted
            expected = {key: revision for key, revision in model.frozen.items() if key not in withdrawn} if counts else {}
            assert (states[batch].counts, rows) == (counts, expected), batch
        history = [row for row in reader.rows(Annotation) if row.batch_id in self.models]
        assert len(history) == sum(len(revisions) for model in self.models.values() for revisions in model.revisions.values())
        assert len(reader.rows(Assignment)) == len(KEYS)


Gate.TestCase.settings = settings(
    max_examples=8, stateful_step_count=15, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
TestGate = pytest.mark.whole(Gate.TestCase)
