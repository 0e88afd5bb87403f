-- Each part of the lake was trained on twice: which candidates are chosen, and what stands on large objects. Agents learned twice, too.
SELECT
    digest(model, part) AS model_id,
    training || '-' || part AS training_id,
    kind,
    'trained' AS origin,
    architecture,
    300000 AS parameter_count,
    '{"kind": "' || kind || '"}' AS config,
    digest(model || ' weights', part) || '.weights' AS weights_blob,
    600000 AS weights_bytes,
    'snapshot ' || part AS dataset,
    part AS snapshot_id,
    NULL AS release,
    digest('learned from', part) AS dataset_fingerprint,
    ['test=200', 'train=800'] AS examples,
    0 AS seed,
    digest('training code', kind) AS code_fingerprint,
    'cpu' AS device,
    600.0 AS seconds,
    'CC0-1.0' AS license,
    NULL AS parent_id,
    TRUE AS is_fallback,
    FALSE AS is_withdrawn,
    [] AS notes
FROM (SELECT DISTINCT part FROM scenes_now)
CROSS JOIN (
    VALUES
        ('learned', 'selection', 'selection', 'point-bert'),
        ('drawing model', 'synthesis', 'synthesis', 'physcene-transformer'),
        ('walks scenes', 'navigation-scenes', 'navigation', 'small'),
        ('walks scans', 'navigation-scans', 'navigation', 'small')
) AS systems(model, training, kind, architecture)
