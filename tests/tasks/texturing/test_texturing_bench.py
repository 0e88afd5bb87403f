"""The benchmark of textures: what it measures of one object, and how it sums up."""

from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

from bench.machine import machine
from bench.models.texturing import KINDS, TexturingBench, laid_out, paired, print_texturing, scanned_and_baked
from tasks.furniture import generate
from tasks.geometry.meshes import surface_of
from tasks.texturing.unwrapping import SmartUvUnwrapper, XatlasUnwrapper


def test_layouts_side_by_side() -> None:
    surface = surface_of(generate("mug", None, np.random.default_rng(0)).parts)
    plain = laid_out("generator", "mug", surface, XatlasUnwrapper())
    assert (plain["tool"], plain["problem"], plain["faces"], plain["overlap"]) == ("xatlas", "", len(surface.faces), 0.0)
    failed = laid_out("generator", "mug", surface, SmartUvUnwrapper())
    assert "is no program that can be run" in failed["problem"]
    smart = plain | {"tool": "smart_uv", "charts": 3}
    assert paired([plain, failed, smart, plain | {"name": "other"}]) == [(plain, smart)]
    text = io.StringIO()
    report = {"machine": machine(), "seed": 0, "layouts": [plain, smart, failed], "bakes": [], "goals": []}
    print_texturing(report, Console(file=text, width=200))
    assert "mug by smart_uv: smart_uv: smart_uv.program: is no program" in text.getvalue()


@pytest.mark.slow
@pytest.mark.whole
def test_what_is_baked_from_better_scans_is_better() -> None:
    rows = scanned_and_baked("stool", generate("stool", (0.4, 0.4, 0.5), np.random.default_rng(0)).parts, TexturingBench())
    exact, noisy, drifting = ({row["kind"]: row for row in rows}[kind] for kind in KINDS)
    assert exact["median"] < noisy["median"] < drifting["median"]
    assert exact["median"] < 1.0
    assert exact["mean"] < 5.0
    assert abs(exact["bias"]) < 2.0
    assert exact["seen_share"] > 0.4
