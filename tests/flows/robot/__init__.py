"""Carts in the scenes of a lake."""
