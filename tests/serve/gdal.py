"""Reads a served map with GDAL's own programs, by its driver for PostGIS: gdal.py POSTGRES"""

import json
import subprocess
import sys

import psycopg


def run(*command):
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and "ERROR" not in done.stderr, (command, done.stdout, done.stderr)
    return done.stdout


def main(postgres):
    host, port = postgres.split(":")
    source = f"PG:host={host} port={port} dbname=map user=me"
    client = psycopg.connect(host=host, port=port, dbname="map", user="me", autocommit=True)
    listed = run("ogrinfo", "-ro", source)
    for layer in ("lanes", "intersections"):
        assert f": {layer}" in listed, listed
    written = json.loads(run("ogr2ogr", "-f", "GeoJSON", "-lco", "RFC7946=NO", "/vsistdout/", source, "lanes"))
    lanes = client.execute("SELECT lane, st_npoints(geometry), st_xmin(geometry) FROM lanes ORDER BY lane").fetchall()
    read = sorted((one["properties"]["lane"], len(line), min(at[0] for at in line)) for one in written["features"] for line in [one["geometry"]["coordinates"]])
    assert len(read) == len(lanes) > 0
    for (lane, points, least), (same, count, edge) in zip(read, lanes):
        assert (lane, points) == (same, count) and abs(least - edge) < 1e-6
    # What is asked of it goes to the server: a window, and a condition.
    _, _, edge = lanes[0]
    window = ["-spat", str(edge - 1), "-1e6", str(edge + 1e-3), "1e6"]
    found = run("ogrinfo", "-ro", "-so", source, "lanes", *window)
    (count,) = [int(line.split(":")[1]) for line in found.splitlines() if line.startswith("Feature Count")]
    assert 0 < count <= len(lanes), found
    found = run("ogrinfo", "-ro", "-q", "-where", f"lane = {lanes[0][0]}", source, "lanes")
    assert found.count("OGRFeature(lanes)") == 1, found


main(*sys.argv[1:])
