"""How well capture finds objects in real RGB-D frames: held against masks that were drawn by hand."""
