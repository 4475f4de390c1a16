"""Small queries by many clients on a served map, with versions published beside them: MAP [SECONDS] [CLIENTS].

Clients keep a connection of Postgres' protocol and ask one small query a second each, or as fast as they can.
Prints latency, and the server's memory at the beginning and the end. The map gets new versions: give it a copy."""

import json
import random
import re
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psycopg

EVERMAP = Path(__file__).parents[2] / "target/release/evermap"
# Of layers that every version has, those too that the plan `labels` publishes.
QUERIES = [
    "SELECT count(*) FROM poses",
    "SELECT session, max(stamp) FROM poses GROUP BY session",
    "SELECT frame, map_from_frame['x'] AS x FROM map_frames ORDER BY frame LIMIT 5",
    "SELECT session, stamp, map_from_vehicle['x'] AS x FROM poses ORDER BY x DESC LIMIT 3",
]


def memory(server):
    lines = Path(f"/proc/{server.pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS:")).split()[1]) >> 10


def client(address, seconds, pause, found, wrong):
    with psycopg.connect(address, autocommit=True) as connection:
        end = time.monotonic() + seconds
        newest = 0
        while time.monotonic() < end:
            begun = time.perf_counter()
            connection.execute(random.choice(QUERIES)).fetchall()
            found.append(time.perf_counter() - begun)
            if random.random() < 0.02:
                version = connection.execute("SELECT max(version) FROM versions").fetchone()[0]
                if version < newest:
                    wrong.append((version, newest))
                newest = version
            time.sleep(random.uniform(0, 2 * pause))


def publish(path, site, seconds, published, name):
    """Says something of the map, and runs the plan that takes it in, once a minute."""
    end = time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as folder:
        while time.monotonic() + 20 < end:
            number = len(published)
            ring = [[number, 0], [number + 2, 0], [number + 2, 5], [number, 5], [number, 0]]
            feature = {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [ring]}, "properties": {"kind": "spot"}}
            said, log = Path(folder) / f"{name}_{number}.json", Path(folder) / f"{name}_{number}.mcap"
            said.write_text(json.dumps(feature))
            where = ["--map", path, "--site", site]
            for arguments in [["annotate", *where, "--import", said, "--out", log], ["run", "labels", *where, "--sessions", log]]:
                ended = subprocess.run([EVERMAP, *arguments], capture_output=True, text=True)
                if ended.returncode not in (0, 3):
                    print(ended.stderr, file=sys.stderr)
            published.append(number)
            time.sleep(max(0, min(60, end - time.monotonic() - 20)))


def measured(address, path, site, seconds, clients, pause, server):
    found, wrong, published = [], [], []
    before = memory(server)
    threads = [threading.Thread(target=client, args=(address, seconds, pause, found, wrong)) for _ in range(clients)]
    threads.append(threading.Thread(target=publish, args=(path, site, seconds, published, f"said_{pause:.0f}")))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    found.sort()
    at = lambda share: 1000 * found[min(len(found) - 1, int(share * len(found)))]
    print(
        f"{clients} clients, {'a query a second each' if pause else 'as fast as they can'}, {seconds:.0f} s: {len(found)} queries, "
        f"{len(found) / seconds:.0f} a second; p50 {at(0.5):.1f} ms, p99 {at(0.99):.1f} ms, most {at(1):.0f} ms; "
        f"{len(published)} versions beside; older than before {len(wrong)}; memory {before} MiB, then {memory(server)} MiB",
        flush=True,
    )


def main(path, seconds=600, clients=50):
    arguments = [EVERMAP, "serve", "--map", path, "--http", "127.0.0.1:0", "--postgres", "127.0.0.1:0"]
    server = subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True)
    try:
        said = ""
        while "Postgres:" not in said:
            said += server.stderr.readline()
        address = re.search(r"postgresql://\S+", said)[0]
        with psycopg.connect(address, autocommit=True) as connection:
            site = connection.execute("SELECT DISTINCT site FROM poses").fetchone()[0]
            for query in QUERIES:
                connection.execute(query).fetchall()
        measured(address, path, site, float(seconds), int(clients), 1.0, server)
        measured(address, path, site, 60.0, int(clients), 0.0, server)
    finally:
        server.kill()


main(*sys.argv[1:])
