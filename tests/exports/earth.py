"""Reads lanes of one map that lies on earth with GDAL's and PROJ's eyes, from files and from a server: PARQUET GEOJSON LOCAL HTTP."""

import json
import sys
import urllib.parse
import urllib.request

import geopandas


def coordinates(frame):
    return [point for line in frame.geometry for point in line.coords]


def main(parquet, geojson, local, http):
    metres = geopandas.read_parquet(parquet)
    assert metres.crs.is_projected and metres.crs.axis_info[0].direction == "east", metres.crs
    projected = coordinates(metres.to_crs(4326))
    degrees = coordinates(geopandas.read_file(geojson))
    assert len(projected) == len(degrees) > 10
    # A microdegree is 0.1 m: PROJ's projection and our plane agree to a tenth of a millimetre.
    assert max(abs(a - b) for p, q in zip(projected, degrees) for a, b in zip(p[:2], q[:2])) < 1e-9
    assert all(abs(p[2] - q[2]) < 1e-6 for p, q in zip(coordinates(metres), degrees))
    assert all(10.5 < longitude < 10.6 and 52.2 < latitude < 52.3 for longitude, latitude, _ in degrees)
    own = json.load(open(local))
    assert own["coordinates"].startswith("local metres")
    lines = [feature["geometry"]["coordinates"] for feature in own["features"]]
    lengths = [geopandas.GeoSeries.from_wkt([text(line)]).length.iloc[0] for line in lines]
    assert all(abs(a - b) < 1e-6 for a, b in zip(lengths, metres.geometry.length)), "turned, not stretched"

    def served(path):
        return json.load(urllib.request.urlopen(f"http://{http}/{path}&format=geojson"))

    def query(sql):
        return served("sql?query=" + urllib.parse.quote(sql))

    exported = json.load(open(geojson))
    for found in [served("layers/lanes?version=1"), query("SELECT site, lane, geometry FROM lanes")]:
        assert found["coordinates"] == exported["coordinates"], found["coordinates"]
        assert lines_of(found) == lines_of(exported)
    # Nobody knows where rows without a site lie.
    for found in [served("layers/lanes?local=true"), query("SELECT lane, geometry FROM lanes")]:
        assert found["coordinates"] == own["coordinates"] and lines_of(found) == lines


def lines_of(collection):
    return [feature["geometry"]["coordinates"] for feature in collection["features"]]


def text(line):
    return "LINESTRING (" + ", ".join(f"{x} {y}" for x, y, _ in line) + ")"


main(*sys.argv[1:])
