-- How far features are from where the map's landmarks project, by camera and session. Outliers count for little.
SELECT site, session, o['camera'] AS camera, count(*) AS observations,
       round(sqrt(avg(power(o['residual_px'], 2)) FILTER (WHERE o['weight'] > 0.5)), 3) AS rms_px,
       round(median(o['residual_px']), 3) AS median_px,
       count(*) FILTER (WHERE o['weight'] <= 0.5) AS outliers
FROM (SELECT site, session, unnest(observations) AS o FROM adjusted_poses)
GROUP BY site, session, camera ORDER BY site, session, camera
