-- How did what the lake holds grow from release to release?
-- Version 1.
-- Releases up to the snapshot that is read, the oldest state first.
SELECT
    name,
    snapshot_id,
    created_at,
    scenes,
    rooms,
    objects,
    categories,
    assets,
    placed_objects,
    episodes
FROM releases
ORDER BY snapshot_id, created_at, name
