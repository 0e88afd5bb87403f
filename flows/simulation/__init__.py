"""Scenes of a lake to act in, for code that knows nothing of lakes: environments of gymnasium."""
