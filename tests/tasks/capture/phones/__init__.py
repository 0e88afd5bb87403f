"""Exports of apps on phones: captured rooms and LiDAR meshes."""
