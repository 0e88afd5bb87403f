"""Synthesis models by name: the small ones that are trained here, and the published sizes."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from tasks.synthesis.model.config import Atiss, DiffuScene, Diffusion, LearnedText, Noise, PhyScene, Unet

PAPER_SLOTS = 24
"""The large object and 23."""

PAPER_TEXT = LearnedText(width=512)
"""Of the shape of CLIP's vectors; name weights to have those."""

PAPER_UNET = Unet(width=512, levels=4, groups=8, heads=4, head_width=32, instance_width=128, crosses=True)

PAPER_BETAS = (1e-4, 0.02)
"""Variances that the first and the last of 1000 steps add."""

PRESETS: Mapping[str, Diffusion | Atiss] = MappingProxyType(
    {
        "diffuscene": DiffuScene(),
        "physcene": PhyScene(),
        "atiss": Atiss(),
        "diffuscene-unet": DiffuScene(architecture=Unet()),
        "diffuscene-paper": DiffuScene(
            PAPER_SLOTS,
            "all",
            PAPER_TEXT,
            "middles",
            0.0,
            PAPER_UNET,
            Noise(1000, *PAPER_BETAS, weighting="snr", curve="linear"),
            "numbers",
        ),
        "physcene-paper": PhyScene(
            PAPER_SLOTS, "all", PAPER_TEXT, "middles", 0.0, PAPER_UNET, Noise(1000, *PAPER_BETAS, target="eps", curve="linear"), "numbers"
        ),
        "atiss-paper": Atiss(
            PAPER_SLOTS, "all", PAPER_TEXT, "middles", 0.0, embedding=64, layers=4, heads=8, feedforward=1024, dropout=0.1
        ),
    }
)
"""By name; `-paper`: as published, of the specs D.3 to D.5."""
