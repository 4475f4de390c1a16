"""What a fleet costs beyond its work: many small logs of odometry through `trajectory`.

    fleet.py FOLDER [--sessions 10000] [--messages 130] [--evermap PROGRAM] [--cluster ADDRESS]

Logs are made in FOLDER on first use. A table says, for a tenth, a third and all of them: the first run, and what of it
is beyond the units' own work (by the layer `runs`: the sum of their seconds, shared by the cores); the same run again,
and one session more; then `layers`, `versions`, `explain` and `lineage` on the map.
"""

import argparse
import os
import random
import resource
import shutil
import subprocess
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from mcap.writer import CompressionType
from recordings import odometries, write


def log(path, seed, messages):
    """A log of a vehicle that wanders."""
    indices = range(messages * seed, messages * (seed + 1))
    write(path, "odometry", CompressionType.ZSTD, odometries(random.Random(seed), indices))


def make(folder, count, messages):
    """The logs that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"drive_{number:05}.mcap" for number in range(count)]
    missing = [(path, number) for number, path in enumerate(paths) if not path.exists()]
    with ProcessPoolExecutor() as pool:
        for made in [pool.submit(log, path, number, messages) for path, number in missing]:
            made.result()
    return paths


def run(command):
    """Seconds and largest resident MiB of a command."""
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    said = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    if status != 0:
        raise SystemExit(f"{' '.join(command)[:300]}\n{said.decode()[-2000:]}")
    return time.perf_counter() - start, used.ru_maxrss / 1024


def worked(evermap, store):
    """Seconds that the units of the newest version were at work, all together."""
    query = "SELECT sum(seconds) AS seconds FROM runs WHERE NOT cached"
    told = subprocess.run(
        [evermap, "sql", "--map", str(store), "--format", "csv", query], check=True, capture_output=True, text=True
    )
    return float(told.stdout.split()[-1])


def main():
    """Prints a row for each size of the fleet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sessions", type=int, default=10_000)
    parser.add_argument("--messages", type=int, default=130, help="in a log; 130 are 0.1 MB, 1300 are 1 MB")
    parser.add_argument("--evermap", default="target/release/evermap")
    parser.add_argument("--cluster", help="a scheduler, df://HOST:PORT")
    given = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_NOFILE, (resource.getrlimit(resource.RLIMIT_NOFILE)[1],) * 2)
    paths = make(given.folder / "logs", given.sessions + 1, given.messages)
    cluster = ["--cluster", given.cluster] if given.cluster else []
    print("| sessions | first run s | ms a session | beyond the work ms | MiB | again s | one more s | layers s | versions s | explain s | lineage s | of one session s | manifest kB |")
    print("|---|---|---|---|---|---|---|---|---|---|---|---|---|")
    for count in sorted({given.sessions // 10, given.sessions // 3, given.sessions}):
        chosen, store = given.folder / "chosen", given.folder / "map"
        for old in (chosen, store):
            shutil.rmtree(old, ignore_errors=True)
        chosen.mkdir()
        for path in paths[:count]:
            os.link(path, chosen / path.name)
        time.sleep(3)  # times within two seconds say nothing of a file
        program = [given.evermap, "run", "trajectory", "--map", str(store), "--sessions", f"{chosen}/*.mcap", *cluster]
        first, memory = run(program)
        beyond = first - worked(given.evermap, store) / (os.cpu_count() if not cluster else 1)
        again, _ = run(program)
        os.link(paths[count], chosen / paths[count].name)
        more, _ = run(program)
        on_map = lambda *words: run([given.evermap, *words, "--map", str(store)])[0]
        layers, versions = on_map("layers"), on_map("versions")
        explain, _ = run([given.evermap, "explain", "trajectory", "--map", str(store), "--sessions", f"{chosen}/*.mcap"])
        lineage = on_map("sql", "SELECT count(*) FROM lineage('lanes')")
        of_one = on_map("sql", f"SELECT count(*) FROM lineage('lanes', '{paths[0].stem}')")
        manifest = max(path.stat().st_size for path in (store / "versions").iterdir()) / 1000
        print(
            f"| {count} | {first:.1f} | {1000 * first / count:.2f} | {1000 * beyond / count:.2f} | {memory:.0f} | {again:.1f} | {more:.1f} "
            f"| {layers:.2f} | {versions:.2f} | {explain:.2f} | {lineage:.2f} | {of_one:.2f} | {manifest:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
