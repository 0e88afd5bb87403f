-- What the rows of all tables are made from: chance by hashing, and the scenes, objects, candidates and episodes of a part of the lake.
-- Every value depends on the seed, on what it belongs to and on its own name, never on the order in which rows are made.
CREATE MACRO u(object, name) AS (hash(object, name, getvariable('seed')) >> 11) / 9007199254740992.0;
CREATE MACRO below(object, name, count) AS CAST(floor(count * u(object, name)) AS BIGINT);
CREATE MACRO normal(object, name) AS sqrt(-2 * ln(1 - u(object, name))) * cos(2 * pi() * u(object, name || ' turn'));
CREATE MACRO digest(kind, object) AS sha256(concat(kind, '/', getvariable('seed'), '/', object));
CREATE MACRO pose(yaw, x, y, z) AS
    [cos(yaw), -sin(yaw), 0.0, x, sin(yaw), cos(yaw), 0.0, y, 0.0, 0.0, 1.0, z, 0.0, 0.0, 0.0, 1.0]::DOUBLE[];
CREATE MACRO name_of(number) AS lpad(CAST(number AS VARCHAR), 4, '0');
CREATE MACRO run_of(stage, place, version) AS digest('run ' || stage || ' ' || version, place);
CREATE MACRO at_second(seconds) AS make_timestamptz(CAST(1767225600000000 + 1000000 * (seconds) AS BIGINT));

-- Every tenth scene shows the room of the one before it again. Two scenes in a row have 40 objects on average.
CREATE TABLE scene_list AS
SELECT
    *,
    'generated/scene' || lpad(CAST(room AS VARCHAR), 6, '0') AS room_id,
    'generated/scene' || lpad(CAST(room AS VARCHAR), 6, '0') || CASE WHEN is_rescan THEN '_01' ELSE '_00' END AS scene_id,
    CASE WHEN u(room, 'split') < 0.8 THEN 'train' ELSE 'test' END AS split,
    3 + round(5 * u(room, 'width'), 2) AS room_width,
    3 + round(4 * u(room, 'depth'), 2) AS room_depth,
    digest('capture', scene) AS scan_hash
FROM (
    SELECT
        scene,
        scene % 10 = 9 AS is_rescan,
        scene - scene // 10 - CAST(scene % 10 = 9 AS BIGINT) AS room,
        list_sum(list_transform(getvariable('parts'), lambda first: CAST(first <= scene AS BIGINT))) AS part,
        5 + below(scene, 'structures', 3) AS structures,
        40 + CASE
            WHEN scene % 2 = 1 THEN -below(scene // 2, 'objects', 26)
            WHEN scene + 1 < getvariable('scenes') THEN below(scene // 2, 'objects', 26)
            ELSE 0
        END AS objects
    FROM range(getvariable('scenes')) AS numbered(scene)
);

CREATE VIEW scenes_now AS FROM scene_list WHERE part = getvariable('part');

-- Walls, floor and ceiling come first.
CREATE VIEW instances_now AS
SELECT *, scene * 1000 + place AS object, name_of(place) AS instance_id, place < structures AS is_structure, place - structures AS number
FROM (SELECT *, unnest(range(structures + objects)) AS place FROM scenes_now);

CREATE VIEW shaped_now AS
SELECT
    * EXCLUDE (ratio_x, ratio_y, ratio_z, pick),
    size_x * size_y * size_z AS volume,
    0.3 + round((room_width - 0.6) * u(object, 'x'), 3) AS x,
    0.3 + round((room_depth - 0.6) * u(object, 'y'), 3) AS y,
    radians(below(object, 'yaw', 360)) AS yaw,
    7 + below(object, 'filled', 4) AS filled,
    below(object, 'shift', 10) AS shift
FROM (
    SELECT
        *,
        exp((log_volume + log_spread * normal(object, 'volume')) / 3 + 0.2 * normal(object, 'length')) * ratio_x AS size_x,
        exp((log_volume + log_spread * normal(object, 'volume')) / 3 + 0.2 * normal(object, 'depth')) * ratio_y AS size_y,
        exp((log_volume + log_spread * normal(object, 'volume')) / 3 - 0.2 * normal(object, 'length') - 0.2 * normal(object, 'depth'))
            * ratio_z AS size_z
    FROM instances_now
    JOIN picks ON picks.pick = below(instances_now.object, 'category', 65536)
);
CREATE VIEW objects_now AS FROM shaped_now WHERE NOT is_structure;

-- Seven to ten slots of an object are filled. Slot 5 holds what was cut from its own scan, all others an asset of the shared library.
CREATE VIEW slots_now AS
SELECT *, 1 + (slot - 1 - shift + 10) % 10 AS rank, library_start + below(object * 16 + slot, 'asset', library_count) AS library_index
FROM (SELECT *, unnest(range(1, 11)) AS slot FROM objects_now);

CREATE VIEW ranks_now AS
SELECT *, library_start + below(object * 16 + slot, 'asset', library_count) AS library_index
FROM (SELECT *, 1 + (shift + rank - 1) % 10 AS slot FROM (SELECT *, unnest(range(1, filled + 1)) AS rank FROM objects_now));

CREATE MACRO asset_of(object, slot, library_asset) AS CASE WHEN slot = 5 THEN digest('own asset', object) ELSE library_asset END;

-- One scene in a hundred was annotated by three people, in a batch of its own.
CREATE MACRO is_annotated(scene) AS scene % 100 = 7;
CREATE MACRO batch_of(scene) AS 'batch-' || lpad(CAST(scene // 100 AS VARCHAR), 5, '0');
CREATE MACRO answer_of(object, annotator) AS CASE
    WHEN u(object * 4 + annotator, 'answer') < 0.75 THEN 1
    WHEN u(object * 4 + annotator, 'answer') < 0.93 THEN 2 + below(object * 4 + annotator, 'other', 3)
END;

-- Three answers for each object of an annotated scene, in the order in which they are drawn to be reviewed.
CREATE MACRO wrong_of(scene) AS CASE WHEN u(scene, 'returned') < 0.2 THEN 3 + below(scene, 'wrong', 5) ELSE 0 END;
CREATE VIEW asked_now AS
SELECT
    *,
    batch_of(scene) AS batch_id,
    'annotator-' || annotator_number AS annotator,
    row_number() OVER (PARTITION BY scene ORDER BY hash(object * 4 + annotator_number, 'drawn', getvariable('seed'))) AS drawn,
    least(3 * objects, 50) AS sampled
FROM (SELECT *, unnest(range(1, 4)) AS annotator_number FROM objects_now WHERE is_annotated(scene));

-- Ten ways per scene, each to one of its objects.
CREATE VIEW episodes_now AS
SELECT *, 1.15 * euclidean AS geodesic, CAST(ceil(1.15 * euclidean / 0.25) AS BIGINT) AS forwards
FROM (
    SELECT *, sqrt((goal_x - start_x) ** 2 + (goal_y - start_y) ** 2) AS euclidean
    FROM (
        SELECT
            *,
            scene * 1000 + place AS object,
            0.3 + (room_width - 0.6) * u(trip, 'start x') AS start_x,
            0.3 + (room_depth - 0.6) * u(trip, 'start y') AS start_y,
            0.3 + (room_width - 0.6) * u(trip, 'goal x') AS goal_x,
            0.3 + (room_depth - 0.6) * u(trip, 'goal y') AS goal_y,
            2 * pi() * u(trip, 'start yaw') AS start_yaw
        FROM (
            SELECT *, structures + below(trip, 'target', objects) AS place
            FROM (SELECT *, scene * 100 + episode AS trip FROM (SELECT *, unnest(range(10)) AS episode FROM scenes_now))
        )
    )
    JOIN picks ON picks.pick = below(scene * 1000 + place, 'category', 65536)
);
CREATE MACRO actions_of(trip, forwards) AS
    list_transform(range(forwards + forwards // 3), lambda step: CASE WHEN step % 4 <> 3 THEN 'forward' WHEN hash(trip, step) % 2 = 0 THEN 'left' ELSE 'right' END)
    || ['stop'];

-- One export in two hundred breaks a rule of its format.
CREATE MACRO is_broken(scene, format) AS u(scene, 'broken ' || format) < 0.005;
