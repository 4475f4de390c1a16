-- The classes that touch most, by the share of all boundary pixels of the first.
SELECT class, other, edges, boundary_px, round(strength, 3) AS strength
FROM relations
ORDER BY strength DESC, class, other
LIMIT 20
