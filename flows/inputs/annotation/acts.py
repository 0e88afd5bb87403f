"""One change of an annotation batch at a time: the batch held, its state read, rows staged and committed."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any, TypeVar

from flows.run.configuration import Configuration
from flows.run.fingerprints import canonical_json, code_fingerprint, digest
from flows.worker import Job, execute
from schemas.annotation import Annotation
from schemas.errors import InputError, LakeError
from schemas.record import rows_to_arrow
from tasks import annotation
from tasks.annotation import BatchActs
from warehouse.lake import Lake
from warehouse.sharing.claims import Claims
from warehouse.tables.gate import BatchState, batch_states
from warehouse.tables.snapshot import Reader

STAGE = annotation.STAGE

WAIT_SECONDS = 60.0
"""How long another change of the same batch is waited for: saving takes about a second."""

R = TypeVar("R")


@dataclasses.dataclass(frozen=True)
class Change:
    """A batch that is held while it is changed. `reader`: the lake as it was when the batch was taken hold of."""

    lake: Lake
    batch_id: str
    reader: Reader
    claims: Claims

    def commit(self, acts: BatchActs, note: str, configuration: Configuration, name: str = "") -> None:
        """Run the stage on what was done to the batch, and commit it. `name`: the file that it comes from, for messages.

        Raises:
            InputError: a row breaks its schema. Nothing was committed then.
            LakeError: the batch is held no more, since this process was stopped for long; somebody else may have changed it. Or it
                cannot be committed; nothing of it stays staged then.
        """
        if self.batch_id not in self.claims.held():
            problem = "this process was stopped for so long that others may have changed it; nothing was saved, try again"
            raise LakeError(f"annotation batch {self.batch_id}: {problem}")
        _commit(self.lake, name or self.batch_id, self.batch_id, acts, note, configuration)


@contextlib.contextmanager
def changing(lake: Lake, batch_id: str) -> Iterator[Change]:
    """Hold a batch while it is changed, and read the lake as it is then; what a change that was killed had staged is in it.

    Raises:
        LakeError: another process has been changing the batch for a minute.
    """
    with lake.claims() as claims:
        end = time.monotonic() + WAIT_SECONDS
        while not claims.claim(batch_id):
            if time.monotonic() > end:
                raise LakeError(f"annotation batch {batch_id}: another process has been changing it for a minute; try again")
            time.sleep(0.05)
        if batch_id in lake.abandoned():
            lake.commit(f"annotation batch {batch_id}", scenes=[batch_id])
        yield Change(lake, batch_id, lake.snapshot(), claims)


def state_in(reader: Reader, batch_id: str) -> BatchState:
    """What a batch is at in a snapshot."""
    return batch_states(reader, [batch_id])[batch_id]


def known_state(reader: Reader, batch_id: str) -> BatchState:
    """What a batch is at that the lake must know.

    Raises:
        InputError: it does not.
    """
    state = state_in(reader, batch_id)
    if state.batch is None and not rows_of(reader, Annotation, batch_id):
        raise InputError(batch_id, "batch_id", "is not in the lake", "`metascenes annotate list` names its batches")
    return state


def rows_of(reader: Reader, record: type[R], batch_id: str) -> list[R]:
    """The lake's rows of a batch, sorted by key."""
    return list(reader.rows_by_key(record, [batch_id]))


def _commit(lake: Lake, name: str, batch_id: str, acts: BatchActs, note: str, configuration: Configuration) -> None:
    config = configuration.stages[STAGE.name]
    content = digest(canonical_json(acts))
    inputs: dict[str, Any] = {"annotation_batch": None, "review_batch": None, "batch_acts": acts, "instances": (), "candidates": ()}
    run = execute(
        Job(
            lake=lake.address,
            scene_id=batch_id,
            stage=STAGE.name,
            config=config,
            config_json=canonical_json(config),
            seed=configuration.seed,
            fingerprint=digest("annotation", content, code_fingerprint("tasks.annotation")),
            reasons=(f"batch_acts={content}",),
            upstream=(),
            attempt=1,
            outside=tuple(inputs.items()),
        )
    )
    if run.error:
        raise InputError(name, "annotations", run.error)
    try:
        lake.commit(note=note, scenes=[batch_id])
    except BaseException:
        lake.unstage(run)  # what was refused must not take effect with the next change
        raise


def same_rows(present: list[Any], rows: list[Any]) -> bool:
    """Whether the lake holds exactly these rows."""
    return bool(present) and rows_to_arrow(present, type(present[0])).equals(rows_to_arrow(rows, type(rows[0])))


def now() -> datetime:
    """The present time in UTC."""
    return datetime.now(UTC)
