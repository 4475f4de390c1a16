-- For each class: views that show it, areas of it in those, and its share of all pixels with a class.
SELECT class, count(DISTINCT view) AS views, round(count(*) / count(DISTINCT view)::DOUBLE, 1) AS areas_per_view,
       round(100.0 * sum(pixels) / sum(sum(pixels)) OVER (), 2) AS percent_of_pixels
FROM (SELECT view, area['class'] AS class, area['pixels'] AS pixels
      FROM (SELECT view, unnest(graph['areas']) AS area FROM views))
GROUP BY class
ORDER BY percent_of_pixels DESC
