"""Scenes that a model draws into the lake: layouts drawn, made scenes of, and put through the stages to the end. Does not import Prefect.

    model = drawing_model(lake, "physcene")
    wanted = asked(lake, SceneRequest(large="desk", room_type="office"))
    done = synthesize(lake, wanted, model, count=20, workers=2)

The same request again does only what is missing: nothing, as a rule.
"""

from __future__ import annotations

from flows.inputs.synthesis.asking import ROOM_TYPES, SceneRequest, asked
from flows.inputs.synthesis.batches import SceneSynthesis, Synthesized, synthesize
from flows.inputs.synthesis.models import KINDS, DrawingModel, drawing_model

__all__ = ["KINDS", "ROOM_TYPES", "DrawingModel", "SceneRequest", "SceneSynthesis", "Synthesized", "asked", "drawing_model", "synthesize"]
