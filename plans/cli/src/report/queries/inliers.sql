-- Landmarks that a keyframe sees: where they are few, its pose is weak.
SELECT site, session, count(*) AS keyframes, min(seen) AS fewest,
       round(median(seen)) AS median, max(seen) AS most,
       count(*) FILTER (WHERE seen < 20) AS below_20
FROM (SELECT site, session, coalesce(array_length(observations), 0) AS seen FROM adjusted_poses)
GROUP BY site, session ORDER BY site, session
