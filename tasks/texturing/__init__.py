"""Texture and UV of assets: unwrapping, what a layout is worth, and baking from the frames of a scan."""
