"""Scenes made of layouts: boxes that a model drew become assets in a room, as rows of the stages from capture to selection."""
