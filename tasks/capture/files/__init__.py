"""Files of a scan, read with bounds: meshes, images, frames, trajectories, documents."""
