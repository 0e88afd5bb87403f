"""Geometry that several stages share: boxes, meshes, convex pieces, surfaces, frames."""
