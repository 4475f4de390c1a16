"""What a second core gains: the same work by one core and by all of them, in turns.

    cores.py SESSION [--runs 5] [--evermap PROGRAM] [--scan PROGRAM]

SESSION is a recording as `make map` makes it (`sessions/initial.mcap`). First whole programs: a scan of one topic,
queries over twenty logs of this kind. Then `car_park` on SESSION, whose steps are compared one by one, as the layer
`runs` tells their times (units one after another, so that each has the cores for itself).
"""

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from side_by_side import Contender, arguments, race

QUERIES = {
    "query: images by size": 'SELECT max(octet_length(data)), count(*) FROM "/camera/front/image/compressed"',
    "query: messages by topic": "SELECT topic, count(*), sum(octet_length(data)) FROM messages GROUP BY topic",
}
DRIVES = 20
SHORTEST_S = 0.5  # steps that take less on one core say more of clocks than of cores


def one_core(command):
    """The same command on one core."""
    return ["taskset", "-c", "0", *command]


def many(session):
    """A folder with so many drives that a query over them is longer than the start of a program."""
    folder = tempfile.mkdtemp(dir=Path(session).parent)
    for number in range(DRIVES):
        os.link(session, Path(folder, f"drive_{number}.mcap"))
    return folder


def row(name, one, all_):
    """A row about what took this long."""
    print(f"| {name} | {one.median:.3f} | {all_.median:.3f} | {one.median / all_.median:.2f}× |", flush=True)


def steps(evermap, session, pinned):
    """Seconds by step of one run into a new map."""
    folder = tempfile.mkdtemp()
    store = str(Path(folder, "map"))
    command = [evermap, "run", "car_park", "--map", store, "--sessions", session, "--jobs", "1", "--progress", "none"]
    subprocess.run(one_core(command) if pinned else command, check=True, capture_output=True)
    query = "SELECT step, sum(seconds) AS seconds FROM runs GROUP BY step"
    told = subprocess.run(
        [evermap, "sql", "--map", store, "--format", "json", query], check=True, capture_output=True
    )
    shutil.rmtree(folder)
    return {row["step"]: row["seconds"] for row in json.loads(told.stdout)}


def main():
    """Prints a row for each piece of work."""
    parser = arguments(__doc__)
    parser.add_argument("session", help="a recording of `make map`")
    given = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        sys.exit("expected two cores or more, found one")
    print(f"| work | one core s | {cores} cores s | gain |\n|---|---|---|---|")
    topic = "/camera/front/image/compressed"
    logs = many(given.session)
    both = [
        Contender("one", one_core([given.scan, given.session, topic, "--threads", "1"])),
        Contender("all", [given.scan, given.session, topic, "--threads", str(cores)]),
    ]
    row("scan of images", *race(both, given.runs))
    for name, query in QUERIES.items():
        command = [given.evermap, "sql", "--sessions", logs, query]
        both = [Contender("one", one_core(command), inner=False), Contender("all", command, inner=False)]
        row(name, *race(both, given.runs))
    shutil.rmtree(logs)
    rounds = [(steps(given.evermap, given.session, True), steps(given.evermap, given.session, False)) for _ in range(2)]
    for step in sorted(rounds[0][0], key=lambda step: -rounds[0][0][step]):
        one, all_ = (statistics.median(each[at][step] for each in rounds) for at in (0, 1))
        if one >= SHORTEST_S:
            print(f"| step {step} | {one:.2f} | {all_:.2f} | {one / all_:.2f}× |", flush=True)


if __name__ == "__main__":
    main()
