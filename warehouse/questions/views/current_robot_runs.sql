-- Which run of a cart counts, where the same way was driven more than once?
-- Version 1.
-- Of every episode, policy, setup and body the run of the newest drive batch: that which was committed last.
WITH order_of_batches AS (
    SELECT scene_id AS batch_id, max(snapshot_id) AS snapshot_id
    FROM stage_runs
    WHERE stage = 'robot' AND outcome = 'done'
    GROUP BY scene_id
)
SELECT robot_runs.*
FROM robot_runs
LEFT JOIN order_of_batches USING (batch_id)
QUALIFY row_number() OVER (
    PARTITION BY policy, run_name, setup, body, scene_id, episode_id
    ORDER BY order_of_batches.snapshot_id DESC NULLS LAST, robot_runs.batch_id DESC
) = 1
ORDER BY scene_id, episode_id, batch_id
