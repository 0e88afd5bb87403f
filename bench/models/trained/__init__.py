"""A small network that parts small objects in frames, learned from the virtual scanner's renders and held against the classical member."""
