-- For each class that moves: how often which class was behind it, of all pixels in which anything was seen behind it. The
-- deviation is a standard one, as views differ.
SELECT site, dynamic, class, pixels, round(100 * probability, 1) AS percent, round(100 * deviation, 1) AS deviation_percent
FROM occlusion_model
ORDER BY site, dynamic, probability DESC, class
