"""Uses the package as the guide does: MAP LOG QUERIES NOTEBOOK. QUERIES is a JSON list of queries with their answers."""

import json
import math
import sys
import threading
import time
from pathlib import Path

import pyarrow

import evermap


def plain(rows):
    """As `evermap sql --format json` writes them."""
    return json.loads(json.dumps(rows.arrow().to_pylist(), default=str))


def equal(a, b):
    """Alike, but for the last digit of numbers that went through text."""
    if isinstance(a, float) and isinstance(b, (int, float)):
        return math.isclose(a, b, rel_tol=1e-12, abs_tol=1e-15)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(equal, a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(equal(a[name], b[name]) for name in a)
    return a == b


def refused(what, says):
    try:
        what()
    except evermap.EvermapError as error:
        assert says in str(error), error
    else:
        raise AssertionError(f"expected an error that says {says}")


def main(path, log, queries, notebook):
    lot = evermap.Map(path)
    assert lot.version == 2 and "lanes" in lot.layers, (lot.version, lot.layers)
    for query, expected in json.loads(Path(queries).read_text()):
        found = plain(lot.sql(query))
        assert equal(found, expected), (query, found[:2], expected[:2])

    # Arrow without a copy: the buffers that pyarrow reads are those of the answer.
    rows = lot.layer("poses")
    once, twice = (pyarrow.table(rows)["session"].chunk(0).buffers()[-1].address for _ in range(2))
    assert once == twice
    assert len(rows) == rows.arrow().num_rows and rows.columns[:2] == ["site", "session"]
    assert "session" in repr(rows)
    empty = lot.sql("SELECT session FROM poses WHERE false")
    assert len(empty) == 0 and empty.arrow().schema.names == ["session"]

    lanes = lot.layer("lanes")
    frame = lanes.pandas()
    assert list(frame.columns) == lanes.columns and len(frame) == len(lanes)
    assert lanes.polars()["lane"].to_list() == frame["lane"].to_list()
    shapes = lanes.geopandas()
    assert abs(shapes.geometry.length - frame["length_m"]).max() < 1e-9 and shapes.crs is None

    before = evermap.Map(path, version=1)
    assert before.version == 1 and len(before.layer("poses")) < len(rows)

    refused(lambda: evermap.Map("/nowhere"), "/nowhere")
    refused(lambda: evermap.Map(path, version=9), "9")
    refused(lambda: lot.layer("lane"), "did you mean `lanes`")
    refused(lambda: lot.sql("DROP TABLE lanes"), "only reads")
    refused(lambda: lot.sql("COPY lanes TO '/tmp/evermap-python.csv'"), "only reads")
    refused(lambda: evermap.run("trajectory", path, ["/nowhere.mcap"], site="lot"), "/nowhere.mcap")
    refused(lambda: evermap.run("trajectry", path), "trajectry")

    odometry = evermap.Log(log)
    assert len(odometry.sql('SELECT * FROM "/odom"')) > 0 and odometry.lost == {}

    # Other threads go on while a query computes.
    ticks = []
    stop = threading.Event()

    def tick():
        while not stop.wait(0.005):
            ticks.append(time.monotonic())

    ticking = threading.Thread(target=tick)
    ticking.start()
    begun = time.monotonic()
    lot.sql("SELECT count(*) FROM generate_series(1, 30000) a, generate_series(1, 3000) b WHERE a.value % 7 = b.value % 5")
    took = time.monotonic() - begun
    stop.set()
    ticking.join()
    assert len(ticks) > 0.3 * took / 0.005 / 2, (len(ticks), took)

    exec(compile(Path(notebook).read_text(), notebook, "exec"), {"__name__": "notebook"})


main(*sys.argv[1:])
