-- Note which assets of the library the candidates of this part name first.
UPDATE library
SET first_part = getvariable('part')
WHERE first_part IS NULL AND library_index IN (SELECT DISTINCT library_index FROM ranks_now WHERE slot <> 5);
