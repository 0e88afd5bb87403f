-- What do scenes take from libraries of the lake?
-- Version 1.
-- Of every library and category of its models. models: in the library, without those of equal bytes; offered: of
-- these, in a slot of some object as the library is now; candidates: slots that they fill; chosen: objects that stand in a replica as one
-- of them; scenes: in which they are candidates. mean_score: of the candidates, by which a library's are ranked.
WITH held AS (
    SELECT library, category, count(*) AS models, count(*) FILTER (is_noncommercial) AS noncommercial_models
    FROM library_models
    WHERE duplicate_by IS DISTINCT FROM 'bytes'
    GROUP BY library, category
),

used AS (
    SELECT
        offers.library,
        library_models.category,
        count(DISTINCT offers.library_file) AS offered,
        count(*) AS candidates,
        count(DISTINCT struct_pack(placements.scene_id, placements.instance_id)) FILTER (placements.instance_id IS NOT NULL) AS chosen,
        count(DISTINCT offers.scene_id) AS scenes,
        avg(offers.library_score) AS mean_score
    FROM candidates AS offers
    JOIN library_models
        ON
            library_models.library = offers.library AND library_models.file = offers.library_file
            AND library_models.asset_id = offers.asset_id
    LEFT JOIN placements
        ON
            placements.scene_id = offers.scene_id AND placements.instance_id = offers.instance_id
            AND placements.asset_id = offers.asset_id
    GROUP BY offers.library, library_models.category
)

SELECT
    library,
    category,
    coalesce(models, 0) AS models,
    coalesce(noncommercial_models, 0) AS noncommercial_models,
    coalesce(offered, 0) AS offered,
    coalesce(candidates, 0) AS candidates,
    coalesce(chosen, 0) AS chosen,
    coalesce(scenes, 0) AS scenes,
    mean_score
FROM held
FULL JOIN used USING (library, category)
ORDER BY candidates DESC, library, category
