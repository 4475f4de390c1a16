-- What nobody saw and was inferred: areas and pixels by what is in front and what is taken to be behind, the mean of the
-- pixels' probabilities, and that of the least sure area.
SELECT site, area['dynamic'] AS dynamic, area['class'] AS class, count(*) AS areas, sum(area['pixels']) AS pixels,
       round(sum(area['pixels'] * area['probability']) / sum(area['pixels']), 3) AS mean_probability,
       round(min(area['probability']), 3) AS lowest_probability
FROM (SELECT site, unnest(inferred) AS area FROM inferred_labels)
GROUP BY site, dynamic, class
ORDER BY site, dynamic, pixels DESC, class
