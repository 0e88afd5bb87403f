-- Every stage of a scene, two of which were run twice; a failed last attempt in one scene of two hundred; one run per batch.
WITH counts AS (
    SELECT
        scene,
        sum(filled) AS selections,
        count(*) FILTER (u(object, 'touches optimized') < 0.45) + count(*) FILTER (u(object, 'touches proposed') < 0.45) AS contacts,
        count(*) FILTER (u(object, 'reach') < 0.015) AS unreachable
    FROM objects_now
    GROUP BY scene
)
SELECT
    place_id AS scene_id,
    stage,
    CASE WHEN place = 'batch' THEN digest('run ' || stage, place_id) ELSE run_of(stage, scene, version) END AS fingerprint,
    1 AS attempt,
    CASE version WHEN 2 THEN 'failed' ELSE 'done' END AS outcome,
    list_transform(reads, lambda above: above || '=' || run_of(above, scene, 1)) AS upstream,
    ['config=' || digest('config', stage), 'code=' || digest('code ' || version, stage), 'seed=0'] AS reasons,
    '{"type": "generated"}' AS config,
    CASE WHEN version = 2 THEN [] ELSE list_concat(
        list_transform(by_object, lambda made: made || '=' || objects), list_transform(by_scene, lambda made: made || '=1')
    ) END || CASE
        WHEN version = 2 THEN []
        WHEN stage = 'capture' THEN [
            'scenes=1', 'shells=1', 'rooms=1', 'surfaces=6', 'frames=100', 'instances=' || (structures + objects),
            'masks=' || 3 * objects, 'syntheses=' || CASE WHEN scene % 40 = 5 THEN 1 ELSE 0 END,
            'synthesis_objects=' || CASE WHEN scene % 40 = 5 THEN least(3, objects - 1) ELSE 0 END
        ]
        WHEN stage = 'captions' THEN ['captions=' || objects]
        WHEN stage = 'candidates' THEN ['candidates=' || 10 * objects]
        WHEN stage = 'selection' THEN ['selections=' || selections]
        WHEN stage = 'optimization' THEN [
            'placements=' || objects, 'supports=' || objects, 'contacts=' || contacts, 'optimization_steps=100', 'optimizations=1',
            'certificates=' || CASE WHEN is_annotated(scene) THEN 3 * objects ELSE 2 * objects END
        ]
        WHEN stage = 'micro_scenes' THEN [
            'micro_scenes=' || (objects + 6) // 8, 'micro_scene_objects=' || (objects // 8 * 3 + greatest(0, least(objects % 8 - 1, 3)))
        ]
        WHEN stage = 'navigation' THEN ['navmeshes=1', 'episodes=10', 'unreachable_targets=' || unreachable, 'splits=1']
        WHEN stage = 'fidelity' THEN ['fidelity=' || objects, 'scene_fidelity=1']
        WHEN stage = 'exports' THEN ['export_files=' || 8 * len(getvariable('formats')), 'export_checks=' || len(getvariable('rules'))]
        WHEN stage = 'annotation' THEN [
            'annotation_batches=1', 'assignments=' || 3 * objects, 'annotations=' || 3 * objects, 'submissions=' || 3 * objects,
            'review_samples=' || least(3 * objects, 50), 'answer_verdicts=' || least(3 * objects, 50), 'quality_reviews=1'
        ]
        WHEN stage = 'evaluation' THEN ['trajectories=10']
        WHEN stage = 'robot' THEN ['robot_runs=10']
        ELSE []
    END AS row_counts,
    CASE
        WHEN stage = 'captions' AND u(scene, 'degraded') < 0.3 THEN [name_of(structures) || ': no answer, classical caption taken']
        WHEN stage = 'candidates' AND u(scene, 'degraded') < 0.1 THEN ['a slot of the library was filled by the generator'] ELSE []
    END AS degradations,
    CASE version WHEN 2 THEN 'scene.usda: mass: is missing; add it' END AS error,
    CASE version WHEN 2 THEN 'input' END AS error_kind,
    at_second(scene * 60 + 10 * version + number) AS started_at,
    mean_seconds * exp(0.4 * normal(scene * 10 + version, 'seconds ' || stage)) AS seconds,
    concat('host-', below(scene, 'host', 8), ':', 1000 + below(scene, 'process', 4)) AS host,
    300 + below(scene, 'memory ' || stage, 600) AS peak_memory_mb,
    part AS snapshot_id
FROM (
    SELECT *, 'scene' AS place, scene_id AS place_id, ran.stage AS stage, ran.reads AS reads, ran.seconds AS mean_seconds,
        ran.number AS number, ran.version AS version, ran.by_object AS by_object, ran.by_scene AS by_scene
    FROM (SELECT *, unnest(getvariable('runs')) AS ran FROM scenes_now)
    WHERE ran.version < 2 OR u(scene, 'failed') < 0.005
    UNION ALL
    SELECT *, 'batch' AS place,
        CASE WHEN ran = 'annotation' THEN batch_of(scene) ELSE concat(ran, '-', lpad(CAST(scene // 100 AS VARCHAR), 5, '0')) END AS place_id,
        CASE ran WHEN 'annotation' THEN ran WHEN 'drive' THEN 'robot' ELSE 'evaluation' END AS stage, [] AS reads, 0.5 AS mean_seconds, 8 AS number, 1 AS version,
        [] AS by_object, [] AS by_scene
    FROM (
        SELECT *, unnest(CASE scene % 100 WHEN 7 THEN ['annotation'] WHEN 3 THEN getvariable('policies') || ['drive'] ELSE [] END) AS ran
        FROM scenes_now
    )
)
JOIN counts USING (scene)
ORDER BY scene_id, stage, fingerprint
