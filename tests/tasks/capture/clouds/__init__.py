"""Surfaces of point clouds."""
