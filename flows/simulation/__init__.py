"""Scenes of a lake to act in, for code that knows nothing of lakes: environments of gymnasium, which knows them once this is imported."""

from __future__ import annotations

from flows.simulation.registration import register

register()
