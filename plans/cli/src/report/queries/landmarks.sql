-- Landmarks by how many sessions saw them: those of several tie the drives together.
SELECT site, coalesce(array_length(sources), 0) AS sessions, count(*) AS landmarks,
       round(median(array_length(sightings))) AS median_sightings,
       round(median(sigma_m), 3) AS median_sigma_m, round(median(rms_px), 3) AS median_rms_px
FROM landmarks GROUP BY site, sessions ORDER BY site, sessions
