-- One file for every fifty models.
SELECT
    'models' AS library,
    concat('refused_', library_index, '.glb') AS file,
    CASE library_index % 3 WHEN 0 THEN 'content' WHEN 1 THEN 'size' ELSE 'faces' END AS field,
    CASE library_index % 3
        WHEN 0 THEN 'cannot be read; export it again' WHEN 1 THEN 'is 300 x 300 x 300 m, which is no object of a room'
        ELSE 'are 3000000, more than 2000000'
    END AS reason
FROM library
WHERE getvariable('part') = 1 AND library_index % 50 = 7
