"""Training learned systems on what the lake holds, and keeping the models that come of it."""
