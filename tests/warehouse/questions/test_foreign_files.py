"""Files that are not the lake's, dropped into it: ignored or refused in one line, and nothing else changes."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from schemas.captions import Caption
from schemas.errors import LakeError
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.questions.test_sql import state
from warehouse.lake import Lake
from warehouse.questions.sql import query
from warehouse.release import make_release
from warehouse.tables.digest import digests

RUN = f"demo%2Fb@captions@{fingerprint(9)}@token"


def filled(folder: Path) -> Lake:
    lake = Lake.open(folder / "lake")
    lake.stage_rows(stage_run("demo/a", "captions", fingerprint(1)), {"captions": [sample(Caption, scene_id="demo/a")]})
    lake.commit()
    make_release(lake, "v1")
    return lake


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize(
    "place",
    [
        "staged/foreign.parquet",
        f"staged/{RUN}@stage_runs.parquet",
        f"staged/{RUN}@captions.parquet",
        "staged/a@b.parquet",
        "tables/captions/part-00000-foreign.snappy.parquet",
        "tables/captions/_delta_log/foreign.parquet",
        "tables/foreign/foreign.parquet",
        "blobs/aa/bb/foreign.parquet",
        "releases/v1/foreign.parquet",
        "releases/foreign.parquet",
        "foreign.parquet",
    ],
)
def test_a_foreign_file_is_no_part_of_the_lake(tmp_path: Path, place: str) -> None:
    lake = filled(tmp_path)
    file = Path(lake.address) / place
    expected = digests(lake.snapshot())
    file.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table({"scene_id": [1, 2], "nothing": ["of", "ours"]}), file)
    before = state(Path(lake.address))

    again = Lake.open(lake.address)
    assert digests(again.snapshot()) == expected
    assert query(again.snapshot(), "SELECT scene_id FROM captions").to_pylist() == [{"scene_id": "demo/a"}]
    refused = None
    try:
        assert again.commit() is None
    except LakeError as error:
        refused = error
    assert state(Path(lake.address)) == before
    if refused is not None:
        assert "\n" not in str(refused)
        assert file.name in str(refused)
        file.unlink()

    again.stage_rows(stage_run("demo/c", "captions", fingerprint(2)), {"captions": [sample(Caption, scene_id="demo/c")]})
    assert again.commit() is not None
    assert {row.scene_id for row in again.snapshot().rows(Caption)} == {"demo/a", "demo/c"}
    assert digests(again.snapshot(1)) == expected
