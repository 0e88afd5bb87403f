-- How well did each trajectory do?
-- Version 3.
-- success: stop was called and the geodesic distance to the nearest view point of the episode's own target is below
-- success_distance_m (Anderson et al., On Evaluation of Embodied Navigation Agents, 2018; Habitat's Success; habitat-lab's ObjectNav
-- takes any other object of the category as well). episode_length: all executed actions, the terminating one included (SPOC's
-- eps_len). spl: success * l / max(p, l), l the geodesic distance at the start and p the travelled length (Anderson et al. 2018;
-- 1 where both are 0); l is exact over the navmesh's polygons, which Detour's, and so habitat-lab's, may exceed.
-- sel: success * w / max(e, w), w the expert's actions and e the episode length (success weighted by episode length as SPOC
-- computes it, Ehsani et al., CVPR 2024; where w is 0, 1 if e is 0 and else 0).
-- found: stop was called below 1 m from a view point with the target in view (is_target_seen), as people would call it; missing where
-- nobody looked. arrived: stop was called below 0.1 m from a view point, habitat-lab's distance for ObjectNav. found_spl: found in the
-- place of success. All are of the same way, whatever success_distance_m was.
-- is_outdated: the lake's episode of that name starts elsewhere or has another target by now, or is gone; the metrics are still
-- those of the episode as it was. is_counted: of all trajectories of the policy's run in an episode, measured at one success distance,
-- this is the one that the views navigation_metrics* count, the newest of those that are not outdated, or the newest where all are.
WITH order_of_batches AS (
    SELECT scene_id AS batch_id, max(snapshot_id) AS snapshot_id
    FROM stage_runs
    WHERE stage = 'evaluation' AND outcome = 'done'
    GROUP BY scene_id
),
judged AS (
    SELECT
        trajectories.*,
        trajectories.called_stop AND coalesce(trajectories.final_distance_m < trajectories.success_distance_m, FALSE) AS success,
        trajectories.called_stop AND coalesce(trajectories.final_distance_m < 0.1, FALSE) AS arrived,
        CASE WHEN trajectories.is_target_seen IS NOT NULL
            THEN trajectories.called_stop AND trajectories.is_target_seen AND coalesce(trajectories.final_distance_m < 1.0, FALSE)
        END AS found,
        len(trajectories.actions) AS episode_length,
        episodes.scene_id IS NULL AS is_outdated,
        row_number() OVER (
            PARTITION BY policy, run_name, success_distance_m, trajectories.scene_id, trajectories.episode_id
            ORDER BY episodes.scene_id IS NULL, order_of_batches.snapshot_id DESC NULLS LAST, trajectories.batch_id DESC
        ) = 1 AS is_counted
    FROM trajectories
    LEFT JOIN order_of_batches USING (batch_id)
    LEFT JOIN episodes
        ON episodes.scene_id = trajectories.scene_id
        AND episodes.episode_id = trajectories.episode_id
        AND episodes.instance_id = trajectories.instance_id
        AND episodes.start_position = trajectories.start_position
        AND episodes.start_yaw_radians = trajectories.start_yaw_radians
)
SELECT
    judged.batch_id,
    judged.scene_id,
    judged.episode_id,
    judged.policy,
    judged.run_name,
    judged.agent,
    judged.split,
    judged.category,
    judged.success_distance_m,
    judged.success,
    judged.episode_length,
    CASE
        WHEN NOT judged.success THEN 0.0
        WHEN judged.start_distance_m = 0 AND judged.travelled_m = 0 THEN 1.0
        ELSE judged.start_distance_m / greatest(judged.travelled_m, judged.start_distance_m)
    END AS spl,
    judged.arrived,
    judged.found,
    CASE
        WHEN judged.found IS NULL THEN NULL
        WHEN NOT judged.found THEN 0.0
        WHEN judged.start_distance_m = 0 AND judged.travelled_m = 0 THEN 1.0
        ELSE judged.start_distance_m / greatest(judged.travelled_m, judged.start_distance_m)
    END AS found_spl,
    CASE
        WHEN NOT judged.success THEN 0.0
        WHEN judged.expert_actions = 0 THEN CASE WHEN judged.episode_length = 0 THEN 1.0 ELSE 0.0 END
        ELSE judged.expert_actions / greatest(judged.episode_length, judged.expert_actions)
    END AS sel,
    trajectory_curvature.curvature_finite_differences_per_m,
    trajectory_curvature.curvature_turning_angle_per_m,
    judged.called_stop,
    judged.collisions,
    judged.travelled_m,
    judged.start_distance_m,
    judged.final_distance_m,
    judged.expert_actions,
    judged.problem,
    judged.is_outdated,
    judged.is_counted
FROM judged
JOIN trajectory_curvature USING (batch_id, scene_id, episode_id)
ORDER BY judged.batch_id, judged.scene_id, judged.episode_id
