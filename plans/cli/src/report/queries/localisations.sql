-- How the sessions that this version added were found in the version before.
SELECT site, session, state, count(*) AS keyframes, round(median(inliers)) AS median_inliers,
       round(median(sigma_m), 4) AS median_sigma_m, round(degrees(median(sigma_rad)), 4) AS median_sigma_deg,
       round(median(rms_px), 3) AS median_rms_px
FROM localisations GROUP BY site, session, state ORDER BY site, session, state
