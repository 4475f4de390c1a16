-- How sure relocation is, by session: the best view's similarity and the second best's.
SELECT session, map_session, count(*) FILTER (WHERE rank = 0) AS queries,
       round(avg(similarity) FILTER (WHERE rank = 0), 3) AS best, round(avg(similarity) FILTER (WHERE rank = 1), 3) AS second
FROM relocations
GROUP BY session, map_session
ORDER BY session, map_session
