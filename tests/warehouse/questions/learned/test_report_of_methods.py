"""The section of the report about selection methods: there where something was measured, left out where nothing was."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from flows.stats.report import write_report
from schemas.training import ModelEvaluation
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake


@pytest.mark.whole
def test_the_report_has_the_papers_table_where_methods_were_measured(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    evaluations = [
        sample(
            ModelEvaluation, training_id="bench", model_id=None, method=method, dataset="generated", split="test", metric=metric,
            value=value, low=value / 2, high=value, examples=1234,
        )
        for method, values in (("extents", {"top_1": 0.25, "chamfer_m": 0.125}), ("geometric", {"top_1": 0.75, "chamfer_m": 0.0625}))
        for metric, value in values.items()
    ]  # fmt: skip
    empty = write_report(lake, tmp_path / "empty.html", workers=1).path.read_text()
    assert "Selection methods" not in empty
    lake.stage_rows(stage_run("bench", "training", fingerprint("bench")), {"model_evaluations": evaluations})
    lake.commit("figures")
    page = write_report(lake, tmp_path / "report.html", workers=1).path.read_text()
    assert '<a href="#selection-methods">' in page
    (section,) = re.findall(r'<section id="selection-methods".*?</section>', page, re.DOTALL)
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", section, re.DOTALL)[1:]]
    assert [row[:4] for row in rows] == [["geometric", "generated", "test", "1\u202f234"], ["extents", "generated", "test", "1\u202f234"]]
    assert [row[4:7] for row in rows] == [["75%", "37.5%", "75%"], ["25%", "12.5%", "25%"]]
    assert "0.0625" in rows[0]
