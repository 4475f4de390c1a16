-- Pixels of what moves: those behind which others saw something, those that nobody saw behind, and those of which what was
-- seen is not clear.
WITH seen AS (
  SELECT site, session, sum(occluded['pixels']) AS seen_px
  FROM (SELECT site, session, unnest(occlusions) AS occluded FROM warped_labels)
  GROUP BY site, session
), labelled AS (
  SELECT site, session, count(*) AS views, sum(unseen_px) AS unseen_px, sum(unclear_px) AS unclear_px
  FROM warped_labels
  GROUP BY site, session
)
SELECT l.site, l.session, views, coalesce(seen_px, 0) AS seen_px, unseen_px, unclear_px,
       round(100.0 * coalesce(seen_px, 0) / nullif(coalesce(seen_px, 0) + unseen_px + unclear_px, 0), 1) AS percent_seen
FROM labelled l LEFT JOIN seen s ON l.site = s.site AND l.session = s.session
ORDER BY l.site, l.session
