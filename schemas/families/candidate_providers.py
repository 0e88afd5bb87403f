"""Candidate providers: who can fill a slot of an instance. The objects are in `tasks.candidates`."""

from __future__ import annotations

CANDIDATE_PROVIDERS = ("procedural", "parametric", "scan_crop", "library", "shap_e", "served", "commanded", "textured")
