-- Places seen again: which loop closures the relaxed poses agree with (weight), and how closely.
SELECT site, session, l['session'] AS other_session, count(*) AS loops,
       count(*) FILTER (WHERE l['weight'] > 0.5) AS accepted,
       count(*) FILTER (WHERE l['weight'] <= 0.5) AS rejected,
       round(median(l['residual_m']) FILTER (WHERE l['weight'] > 0.5), 3) AS median_m,
       round(degrees(median(l['residual_rad']) FILTER (WHERE l['weight'] > 0.5)), 3) AS median_deg
FROM (SELECT site, session, unnest(loops) AS l FROM graph_poses)
GROUP BY site, session, other_session ORDER BY site, session, other_session
