"""The as-of join of evermap beside DuckDB's, on the same layers of a map: asof.py [COPIES]

A simulated drive's odometry, COPIES times over with later stamps, wants the keyframe at or before each of its rows, of ten
times fewer. Both programs start anew for each run, read the Parquet files, join and add up, with all cores; the best of
five counts. `cargo build --release` first.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

EVERMAP = Path(__file__).resolve().parents[2] / "target/release/evermap"
RUNS = 5
SMALL = ["revisits=2", "width_px=32", "height_px=32", "rate_hz=1", "floor_texels_per_m=10"]
PLAN = """\
plan: dense
steps:
  dense:
    sql: >
      SELECT site, session, arrow_cast(CAST(stamp AS BIGINT) + copy * 1000000000000, 'Timestamp(Nanosecond, None)') AS stamp
      FROM odometry CROSS JOIN (SELECT unnest(range(0, {copies})) AS copy)
  sparse:
    sql: >
      SELECT site, session, stamp, CAST(stamp AS BIGINT) % 1000 AS value FROM (
        SELECT *, row_number() OVER (PARTITION BY session ORDER BY stamp) AS nth FROM dense) WHERE nth % 10 = 0
write: [dense, sparse]
"""
COLUMNS = "count(*) AS n, count(s.value) AS found, sum(s.value) AS total"
OURS = f"SELECT {COLUMNS} FROM dense AS d ASOF JOIN sparse AS s MATCH_CONDITION (d.stamp >= s.stamp) ON d.session = s.session"
THEIRS = f"SELECT {COLUMNS} FROM '{{dense}}' d ASOF LEFT JOIN '{{sparse}}' s ON d.session = s.session AND d.stamp >= s.stamp"


def evermap(*arguments):
    command = [EVERMAP, *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def made(folder, copies):
    """The map, and the files of its layers by name."""
    simulate = [part for setting in SMALL for part in ("--set", setting)]
    evermap("simulate", "car_park", "--out", folder / "world", *simulate)
    plan = folder / "dense.yaml"
    plan.write_text(PLAN.format(copies=copies))
    logs = sorted(folder.glob("world/*.mcap"))
    evermap("run", plan, "--map", folder / "map", "--site", "lot", "--sessions", *logs)
    files = {}
    for row in json.loads(evermap("layers", "--map", folder / "map", "--files", "--format", "json")):
        files.setdefault(row["layer"], []).append(row["file"])
    return folder / "map", files


def ours(folder, query):
    return tuple(json.loads(evermap("sql", "--map", folder, "--format", "json", query))[0].values())


def theirs(query):
    code = f"import duckdb, json; print(json.dumps(duckdb.sql({query!r}).fetchall()[0]))"
    done = subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.PIPE, text=True)
    return tuple(json.loads(done.stdout))


def best(ask):
    times = []
    for _ in range(RUNS):
        started = time.perf_counter()
        answer = ask()
        times.append(time.perf_counter() - started)
    return min(times), max(times), answer


def main(copies="200"):
    with tempfile.TemporaryDirectory() as folder:
        folder, files = made(Path(folder), int(copies))
        query = THEIRS.replace("'{dense}'", f"read_parquet({files['dense']})").replace("'{sparse}'", f"read_parquet({files['sparse']})")
        found = {"evermap": best(lambda: ours(folder, OURS)), "DuckDB": best(lambda: theirs(query))}
        starts = {"evermap": best(lambda: ours(folder, "SELECT 1 AS n")), "DuckDB": best(lambda: theirs("SELECT 1"))}
    rows, matched, _ = found["evermap"][2]
    print(f"{rows:,} rows, of which {matched:,} have one before; best of {RUNS} (slowest), and a query of nothing")
    for name, (least, most, _) in found.items():
        print(f"{name:8} {least:.3f} s ({most:.3f}), {starts[name][0]:.3f} s")
    assert found["evermap"][2] == found["DuckDB"][2], f"the answers differ: {found}"
    print(f"evermap takes {found['evermap'][0] / found['DuckDB'][0]:.2f} of DuckDB's time, "
          f"{(found['evermap'][0] - starts['evermap'][0]) / (found['DuckDB'][0] - starts['DuckDB'][0]):.2f} without the start")


main(*sys.argv[1:])
