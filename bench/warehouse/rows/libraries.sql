-- One library, in which all models are that scenes share.
SELECT
    'models' AS library,
    digest('library', 0) AS content,
    NULL AS weights,
    (SELECT count(*) FROM library) AS model_count,
    0 AS duplicate_count,
    (SELECT count(*) FROM library WHERE library_index % 50 = 7) AS refused_count,
    digest('search', 0) || '.index' AS search_blob,
    [] AS notes
FROM scenes_now
WHERE scene = 0
