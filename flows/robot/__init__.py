"""Carts in the scenes of a lake: which ways they drive, and the flow that spreads them over workers."""
