-- Keyframes that hold the map up, and those left out of it: others at their spots show most of what they saw, so that their
-- poses hang off the frames of the map. Versions before still have them.
SELECT f.site, f.session, count(*) AS keyframes, count(a.stamp) AS holding, count(*) - count(a.stamp) AS left_out
FROM frame_poses f LEFT JOIN (SELECT site, session, stamp FROM adjusted_poses) a
  ON f.site = a.site AND f.session = a.session AND f.stamp = a.stamp
GROUP BY f.site, f.session ORDER BY f.site, f.session
