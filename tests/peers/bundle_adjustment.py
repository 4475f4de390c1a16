#!/usr/bin/env python3
"""Bundle adjustment against Ceres: final cost and time, same start, residuals and losses.

Problems are the BAL files given, two made here from a seed (a `street`, whose cameras see their
neighbours, so that the reduced system is sparse, and a `statue`, which all cameras see parts of, so
that it is dense), and drives through one road: with four fisheyes and odometry, each seeing the
landmarks of all. Every solver is run on one and on two threads; of Ceres' Schur solvers the fastest
counts. The CPU time beside it is that of whole processes, reading or making the problem included.

Needs libceres-dev and a C++ compiler, and the release build of the example:

    cargo build --release --example solve_bundle -p evermap-bench
    tests/peers/bundle_adjustment.py [FILE.txt ...]
"""

import argparse
import json
import math
import os
import random
import subprocess
import sys
from pathlib import Path

from side_by_side import compiled

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent


def rotate(angle, p):
    """Rodrigues."""
    t = math.sqrt(sum(a * a for a in angle))
    if t < 1e-12:
        return p
    k = [a / t for a in angle]
    cross = [k[1] * p[2] - k[2] * p[1], k[2] * p[0] - k[0] * p[2], k[0] * p[1] - k[1] * p[0]]
    dot = sum(a * b for a, b in zip(k, p))
    c, s = math.cos(t), math.sin(t)
    return [p[i] * c + cross[i] * s + k[i] * dot * (1 - c) for i in range(3)]


def project(camera, point):
    x, y, z = (a + b for a, b in zip(rotate(camera[:3], point), camera[3:6]))
    px, py = -x / z, -y / z
    n = px * px + py * py
    scale = camera[6] * (1 + n * (camera[7] + camera[8] * n))
    return scale * px, scale * py


def camera_at(position, yaw, rng):
    """Looks along -z of its own frame, turned about y by yaw."""
    angle = [rng.gauss(0, 0.01), -yaw, rng.gauss(0, 0.01)]
    t = rotate(angle, position)
    return [*angle, -t[0], -t[1], -t[2], 800 + rng.gauss(0, 10), -0.01, 0.001]


def street(rng, cameras, points):
    """Cameras half a metre apart that look sideways at two house fronts."""
    made = [camera_at([0.5 * i, 0.0, 0.0], (0.3 if i % 2 else -0.3), rng) for i in range(cameras)]
    seen = []
    for index in range(points):
        x = 0.5 * cameras * rng.random()
        point = [x, rng.uniform(-3, 3), -rng.uniform(8, 14)]
        near = [i for i in range(max(0, int(2 * x) - 30), min(cameras, int(2 * x) + 30)) if rng.random() < 0.3]
        seen.append((point, near))
    return made, seen


def statue(rng, cameras, points):
    """Cameras on a circle that look inwards; each point is seen from a third of it."""
    made = []
    for i in range(cameras):
        yaw = 2 * math.pi * i / cameras
        radius = 8 + rng.random()
        made.append(camera_at([radius * math.sin(yaw), rng.gauss(0, 0.5), radius * math.cos(yaw)], yaw, rng))
    seen = []
    for index in range(points):
        yaw, height = 2 * math.pi * rng.random(), rng.uniform(-2, 2)
        point = [2 * math.sin(yaw), height, 2 * math.cos(yaw)]
        middle = int(yaw / (2 * math.pi) * cameras)
        around = [(middle + i) % cameras for i in range(-cameras // 6, cameras // 6)]
        seen.append((point, [i for i in around if rng.random() < 8 / max(1, len(around))]))
    return made, seen


def write(path, kind, cameras, points, seed):
    rng = random.Random(seed)
    made, seen = kind(rng, cameras, points)
    rows, kept = [], []
    for point, near in seen:
        if len(near) < 2:
            continue
        for i in near:
            u, v = project(made[i], point)
            rows.append((i, len(kept), u + rng.gauss(0, 0.7), v + rng.gauss(0, 0.7)))
        kept.append([p + rng.gauss(0, 0.05) for p in point])
    with open(path, "w") as file:
        print(len(made), len(kept), len(rows), file=file)
        for row in rows:
            print(*row, file=file)
        for camera in made:
            for index, value in enumerate(camera):
                sigma = [0.003] * 3 + [0.03] * 3 + [8, 0.002, 0.0005]
                print(value + rng.gauss(0, sigma[index]), file=file)
        for point in kept:
            print(*point, sep="\n", file=file)


def run(command, repeat):
    """What it says of its fastest run, and the CPU time of one whole process, reading included."""
    with subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, text=True) as process:
        result = json.loads(process.stdout.read())
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{command[0]} failed on {command[1]}")
    result["cpu"] = (usage.ru_utime + usage.ru_stime) / repeat
    return result


def problems(args, ours):
    """Name, what evermap is told, Ceres' program, its file, and its solvers, of each problem."""
    ceres = compiled("ceres_bundle")
    files = list(args.files)
    for name, kind, cameras, points in [
        ("street-200-12000", street, 200, 12000),
        ("statue-100-30000", statue, 100, 30000),
    ]:
        path = args.work / f"{name}.txt"
        if not path.exists():
            write(path, kind, cameras, points, 1)
        files.append(path)
    for path in [] if args.only_drives else files:
        yield path.stem, [path], ceres, path, args.solvers
    ceres = compiled("ceres_drives")
    for drives in args.drives:
        name = f"{drives} drives of {args.keyframes}"
        drive = ["--drive", args.keyframes, "--reach", args.reach, "--drives", drives]
        path = args.work / f"drives-{args.keyframes}-{args.reach}-{drives}.txt"
        if not path.exists():
            subprocess.run([str(word) for word in [ours, *drive, "--write", path]], check=True)
        # A reduced system that is formed takes the cube of how often the road is driven: 81 s for four.
        formed = [] if drives > 2 else ["sparse"]
        yield name, drive, ceres, path, [*formed, "iterative", "clusters"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--work", type=Path, default=ROOT / "target/peers")
    parser.add_argument("--evermap", type=Path, default=None, help="the built example solve_bundle")
    parser.add_argument("--solvers", nargs="+", default=["dense", "sparse", "iterative"], help="on BAL problems")
    parser.add_argument("--drives", nargs="*", type=int, default=[1, 2, 4, 8], help="how often the road is driven")
    parser.add_argument("--only-drives", action="store_true", help="no BAL problems")
    parser.add_argument("--keyframes", type=int, default=400, help="of each drive")
    parser.add_argument("--reach", type=int, default=25, help="keyframes before and after it that see a landmark")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    ours = args.evermap or target / "release/examples/solve_bundle"
    header = [
        "problem", "observations", "cost / Ceres'", "iterations", "evermap s", "Ceres s", "time / Ceres'",
        "CPU / Ceres'", "two threads s", "gain", "Ceres' two threads s", "time / Ceres'",
    ]
    print("| " + " | ".join(header) + " |\n" + "|---" * len(header) + "|")
    for name, told, ceres, path, solvers in problems(args, ours):
        mine, peers, cost = {}, {}, math.inf
        for threads in (1, 2):
            command = [ours, *told, "--threads", threads, "--repeat", args.repeat]
            mine[threads] = run(command, args.repeat)
            print(name, threads, "evermap", mine[threads], file=sys.stderr)
            found = {}
            for solver in solvers:
                found[solver] = run([ceres, path, threads, args.repeat, solver], args.repeat)
                cost = min(cost, found[solver]["final_cost"])
                if not math.isclose(found[solver]["initial_cost"], mine[threads]["initial_cost"], rel_tol=1e-9):
                    raise SystemExit(f"{name}: not the same problem: {found[solver]} {mine[threads]}")
                print(name, threads, solver, found[solver], file=sys.stderr)
            best = min(found, key=lambda solver: found[solver]["seconds"])
            peers[threads] = {**found[best], "name": best, "least_cpu": min(f["cpu"] for f in found.values())}
        one, two = mine[1], mine[2]
        if one["final_cost"] != two["final_cost"]:
            raise SystemExit(f"{name}: the number of threads changed the result")
        row = [
            name, f"{one['observations']:,}", f"{one['final_cost'] / cost:.6f}",
            f"{one['iterations']}, {peers[1]['iterations']}",
            f"{one['seconds']:.3f}", f"{peers[1]['seconds']:.3f} ({peers[1]['name']})",
            f"{one['seconds'] / peers[1]['seconds']:.2f}×", f"{one['cpu'] / peers[1]['least_cpu']:.2f}×",
            f"{two['seconds']:.3f}", f"{one['seconds'] / two['seconds']:.2f}×",
            f"{peers[2]['seconds']:.3f} ({peers[2]['name']})", f"{two['seconds'] / peers[2]['seconds']:.2f}×",
        ]
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
