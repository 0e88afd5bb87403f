-- Each part of the lake was tested in once, by what learned from other scenes and from scans: the walks of two policies stand for theirs.
SELECT
    'comparison-' || part AS comparison_id,
    trained_on,
    0 AS seed,
    scene_id,
    digest('walks ' || trained_on, part) AS model_id,
    'navigation-' || trained_on || '-' || part AS training_id,
    concat(policy, '-', lpad(CAST(scene // 100 AS VARCHAR), 5, '0')) AS batch_id,
    10 AS episodes
FROM scenes_now
CROSS JOIN (SELECT unnest(['scenes', 'scans']) AS trained_on, unnest(getvariable('policies')[:2]) AS policy)
WHERE scene % 100 = 3
