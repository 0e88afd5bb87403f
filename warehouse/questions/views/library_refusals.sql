-- Why are files of libraries refused?
-- Version 1.
-- By what of the file is wrong. example: the first of the files, and why it was refused.
SELECT
    library,
    field,
    count(*) AS files,
    count(*) / any_value(model_count + refused_count) AS share,
    arg_min(file, file) AS example,
    arg_min(reason, file) AS reason
FROM refused_models
JOIN libraries USING (library)
GROUP BY library, field
ORDER BY files DESC, library, field
