"""Memory that the program takes beside `--memory`: ten queries and three plans.

    memory.py FOLDER [--memory 256] [--evermap PROGRAM] [--only WORDS]
              [--width 320] [--height 240] [--revisits 2] [--loops 2]

Sessions of a simulated car park are made in FOLDER on first use; plans come first, and queries on layers ask the map of
`metric_map`. A row says how each ended and the most that it had resident. The goal is 256 MiB beyond the limit.
"""

import argparse
import os
import shutil
import subprocess
from pathlib import Path

BEYOND_MIB = 256

PLANS = ["trajectory", "metric_map", "car_park"]

TEXTS = "(SELECT value AS n, repeat('a', 1000) || value AS t FROM generate_series(1, {}))"

QUERIES = {
    "one row": "SELECT 1",
    "all messages with their payloads, by time": "SELECT * FROM messages ORDER BY log_time, topic",
    "`lag` over all messages, by topic": (
        "SELECT topic, log_time - lag(log_time) OVER (PARTITION BY topic ORDER BY log_time) FROM messages"
    ),
    "`array_agg` of the times of messages, by topic": "SELECT topic, array_agg(log_time) FROM messages GROUP BY topic",
    "features, by keyframe": "SELECT * FROM features ORDER BY keyframe DESC, camera",
    "features joined with themselves": (
        "SELECT a.keyframe, a.descriptors, b.descriptors FROM features a JOIN features b"
        " ON a.session = b.session AND a.camera = b.camera AND a.keyframe = b.keyframe + 1"
    ),
    "1 GB of texts, sorted": f"SELECT t FROM {TEXTS.format(1_000_000)} ORDER BY t DESC",
    "`lag` over 500 MB of texts": (
        f"SELECT lag(t) OVER (PARTITION BY n % 10 ORDER BY n) FROM {TEXTS.format(500_000)}"
    ),
    "10 million rows in 5 million groups": (
        "SELECT count(*) FROM (SELECT value % 5000000 AS k, count(*) FROM generate_series(1, 10000000) GROUP BY k)"
    ),
    "10 million rows joined with as many": (
        "SELECT count(*) FROM generate_series(1, 10000000) a JOIN generate_series(1, 10000000) b ON a.value = b.value"
    ),
}


def run(command):
    """Exit code, largest resident MiB, and what it said, of a command."""
    with open(os.devnull, "w") as nowhere:
        process = subprocess.Popen(command, stdout=nowhere, stderr=subprocess.PIPE)
        said = process.stderr.read().decode()
        _, status, used = os.wait4(process.pid, 0)
    return os.waitstatus_to_exitcode(status), used.ru_maxrss / 1024, said


def made(given):
    """The logs, simulated unless they are there."""
    logs = given.folder / f"{given.width}x{given.height}_{given.revisits}_{given.loops}"
    if not logs.exists():
        unfinished = logs.with_suffix(".unfinished")
        shutil.rmtree(unfinished, ignore_errors=True)
        world = {"width_px": given.width, "height_px": given.height, "loops": given.loops}
        size = [word for name, value in world.items() for word in ("--set", f"{name}={value}")]
        subprocess.run(
            [given.evermap, "simulate", "car_park", "--out", unfinished, "--revisits", str(given.revisits), *size]
            + ["--progress", "none"],
            check=True,
        )
        unfinished.rename(logs)
    return sorted(map(str, logs.glob("*.mcap")))


def main():
    """Prints a row for each plan and query; ends with 1 where one failed or took too much."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--memory", type=int, default=256, help="MiB")
    parser.add_argument("--evermap", default="target/release/evermap")
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--height", type=int, default=240)
    parser.add_argument("--revisits", type=int, default=2)
    parser.add_argument("--loops", type=int, default=2)
    parser.add_argument("--only", default="", help="rows whose name has these words")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    logs, maps = made(given), given.folder / "maps"
    memory = ["--memory", f"{given.memory}MiB"]
    commands = {}
    for plan in PLANS:
        sessions = ["--site", "car_park", "--sessions", *logs]
        commands[f"plan {plan}"] = ["run", plan, "--map", str(maps / plan), "--progress", "none", *memory, *sessions]
    for name, query in QUERIES.items():
        of = ["--map", str(maps / "metric_map")] if " features " in f" {query} " else ["--sessions", *logs]
        commands[name] = ["sql", *of, *memory, "--out", str(given.folder / "answer.parquet"), "--", query]
    failed = False
    print("| | ended with | MiB resident |")
    print("|---|---|---|")
    for name, command in commands.items():
        if given.only not in name:
            continue
        if name.startswith("plan "):
            shutil.rmtree(maps / name.removeprefix("plan "), ignore_errors=True)
        code, mib, said = run([given.evermap, *command])
        failed |= code != 0 or mib > given.memory + BEYOND_MIB
        print(f"| {name} | {code} | {mib:.0f} |", flush=True)
        if code != 0:
            print("\n".join(said.splitlines()[-4:]), flush=True)
    raise SystemExit(int(failed))


if __name__ == "__main__":
    main()
