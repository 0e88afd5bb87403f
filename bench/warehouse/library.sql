-- The library that all scenes share. What no candidate of the lake names is no row of it.
CREATE TABLE library AS
SELECT
    *,
    digest('library asset', library_index) AS asset_id,
    CASE library_index % 3 WHEN 0 THEN 'procedural' WHEN 1 THEN 'generated' ELSE 'library' END AS provider,
    CASE library_index % 4 WHEN 1 THEN 'CC-BY-4.0' WHEN 2 THEN 'CC-BY-NC-4.0' ELSE 'CC0-1.0' END AS license,
    CASE WHEN library_index % 4 IN (1, 2) THEN 'author ' || library_index % 500 END AS author,
    CAST(NULL AS BIGINT) AS first_part
FROM shared;
