"""Small objects that a scan's files do not have: masks of its frames, lifted to points, associated over views, set beside its instances."""
