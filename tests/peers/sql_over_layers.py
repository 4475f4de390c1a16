"""Queries over the layers of a map: evermap's Python package against DuckDB on the same Parquet files, in one process.

    sql_over_layers.py MAP [--evermap PROGRAM]

Both use all cores and hand their answers over as Arrow tables, which are compared. Then the time of a small query with
the start of the program included. `make wheel` first; MAP is a map as `make map` makes it.
"""

import argparse
import json
import math
import statistics
import subprocess
import sys
import time
from pathlib import Path

import duckdb
import evermap
import pyarrow as pa

# Name and query; where the two dialects differ, DuckDB's behind it.
QUERIES = [
    ("drives", "SELECT session, count(*) AS poses, min(stamp) AS first, max(stamp) AS last FROM poses GROUP BY session"),
    (
        "metres driven (window, structs)",
        """WITH places AS (
             SELECT session, stamp, map_from_vehicle['x'] AS x, map_from_vehicle['y'] AS y FROM poses),
           steps AS (
             SELECT session, x - lag(x) OVER drive AS dx, y - lag(y) OVER drive AS dy FROM places
             WINDOW drive AS (PARTITION BY session ORDER BY stamp))
           SELECT session, sum(sqrt(dx * dx + dy * dy)) AS metres FROM steps GROUP BY session""",
    ),
    ("landmarks' quality", "SELECT count(*) AS n, avg(rms_px) AS rms_px, max(sigma_m) AS sigma_m FROM landmarks"),
    (
        "landmarks by square metre (spatial filter)",
        """SELECT floor(x) AS x, floor(y) AS y, count(*) AS n, avg(z) AS z FROM landmarks
           WHERE x BETWEEN -20 AND 20 AND y BETWEEN -20 AND 20 GROUP BY floor(x), floor(y)""",
    ),
    (
        "sightings by drive (lists unnested)",
        """SELECT s['session'] AS session, count(*) AS n, count(DISTINCT s['keyframe']) AS keyframes
           FROM (SELECT unnest(sightings) AS s FROM landmarks) AS seen GROUP BY s['session']""",
    ),
    (
        "size of what is seen, by camera (lists unnested)",
        """SELECT o['camera'] AS camera, count(*) AS n, avg(o['size_px']) AS size_px
           FROM (SELECT unnest(observations) AS o FROM adjusted_poses) AS seen GROUP BY o['camera']""",
    ),
    (
        "poses against localisations (join)",
        """SELECT p.session, count(*) AS n,
             max(abs(p.map_from_vehicle['x'] - l.map_from_vehicle['x'])) AS moved_m
           FROM poses AS p JOIN localisations AS l ON p.session = l.session AND p.stamp = l.stamp
           GROUP BY p.session""",
    ),
    (
        "landmarks around poses (join on a grid)",
        """SELECT p.session, count(*) AS near FROM poses AS p
           JOIN landmarks AS l ON floor(p.map_from_vehicle['x'] / 5) = floor(l.x / 5)
             AND floor(p.map_from_vehicle['y'] / 5) = floor(l.y / 5)
           GROUP BY p.session""",
    ),
    (
        "heights of the surface (histogram)",
        "SELECT session, floor(height_m * 10) AS decimetres, count(*) AS n FROM surface_points GROUP BY session, floor(height_m * 10)",
    ),
    (
        "best closures of each drive (window)",
        """SELECT session, keyframe, other_session, other_keyframe, sigma_m FROM (
             SELECT session, keyframe, other_session, other_keyframe, sigma_m,
               row_number() OVER (PARTITION BY session ORDER BY sigma_m, keyframe, other_session, other_keyframe) AS place
             FROM loop_closures) AS placed WHERE place <= 5""",
    ),
    (
        "features of the images (lengths of lists)",
        "SELECT session, camera, sum(array_length(u)) AS features FROM features GROUP BY session, camera",
        "SELECT session, camera, sum(len(u)) AS features FROM features GROUP BY session, camera",
    ),
    (
        "poses at what was seen (as-of join)",
        """SELECT s.session, count(p.stamp) AS n, avg(s.x - p.map_from_vehicle['x']) AS ahead_m
           FROM surface_points AS s ASOF JOIN poses AS p
             MATCH_CONDITION (s.first_stamp >= p.stamp) ON s.session = p.session
           GROUP BY s.session""",
        """SELECT s.session, count(p.stamp) AS n, avg(s.x - p.map_from_vehicle['x']) AS ahead_m
           FROM surface_points AS s ASOF LEFT JOIN poses AS p
             ON s.session = p.session AND s.first_stamp >= p.stamp
           GROUP BY s.session""",
    ),
    ("a million rows", " UNION ALL ".join(["SELECT * FROM surface_points"] * 4)),
]


def files(folder):
    """The Parquet files of each layer of the newest version."""
    versions = sorted(Path(folder, "versions").glob("*.json"), key=lambda path: int(path.stem))
    manifest = json.loads(versions[-1].read_text())
    return {
        name: [str(Path(folder, "artifacts", f"{artifact['content']}.parquet")) for artifact in layer["artifacts"]]
        for name, layer in manifest["layers"].items()
    }


def rows(table):
    """An answer's rows, sorted; numbers are compared to nine digits."""
    table = pa.table(table)
    if table.num_rows > 10_000:
        return table.num_rows

    def plain(value):
        if isinstance(value, (int, float)) and math.isfinite(value):
            return float(f"{value:.9g}")
        return str(value)

    return sorted(map(str, ([plain(value) for value in row.values()] for row in table.to_pylist())))


def timed(work):
    """Seconds, and what came out."""
    start = time.perf_counter()
    made = work()
    return time.perf_counter() - start, made


def race(ours, theirs, runs):
    """Median seconds of each, in turns; the first round warms caches."""
    seconds = [[], []]
    answers = [None, None]
    for number in range(runs + 1):
        for at in (0, 1) if number % 2 else (1, 0):
            took, answers[at] = timed((ours, theirs)[at])
            if number:
                seconds[at].append(took)
    return [statistics.median(each) for each in seconds], answers


def main():
    """Races the two on each query."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("map", help="a map in a folder")
    parser.add_argument("--evermap", default="target/release/evermap", help="our program")
    parser.add_argument("--runs", type=int, default=15, help="counted rounds")
    given = parser.parse_args()
    opened = evermap.Map(given.map)
    peer = duckdb.connect()
    peer.execute("SET TimeZone = 'UTC'")
    for name, paths in files(given.map).items():
        peer.execute(f'CREATE VIEW "{name}" AS SELECT * FROM read_parquet({paths!r})')
    print("| query | evermap ms | DuckDB ms | evermap / DuckDB |\n|---|---|---|---|")
    for name, query, *other in QUERIES:
        theirs = other[0] if other else query
        medians, answers = race(
            lambda query=query: opened.sql(query).arrow(),
            lambda theirs=theirs: peer.sql(theirs).to_arrow_table(),
            given.runs,
        )
        found, expected = map(rows, answers)
        if found != expected:
            sys.exit(f"{name}: not the same answer\nevermap {str(found)[:600]}\nDuckDB  {str(expected)[:600]}")
        ours, theirs = (1000 * each for each in medians)
        print(f"| {name} | {ours:.1f} | {theirs:.1f} | {ours / theirs:.2f} |", flush=True)
    small = "SELECT count(*) FROM lanes"
    lanes = files(given.map)["lanes"]
    script = f"import duckdb; print(duckdb.sql('SELECT count(*) FROM read_parquet({lanes!r})'.replace('\"', chr(39))))"
    command = [given.evermap, "sql", "--map", given.map, small]
    run = lambda command: subprocess.run(command, check=True, capture_output=True)
    medians, _ = race(lambda: run(command), lambda: run([sys.executable, "-c", script]), given.runs)
    ours, theirs = (1000 * each for each in medians)
    print(f"| a small query, programs started | {ours:.0f} | {theirs:.0f} (Python) | {ours / theirs:.2f} |")


if __name__ == "__main__":
    main()
