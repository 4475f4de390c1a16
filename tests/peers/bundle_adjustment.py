#!/usr/bin/env python3
"""Bundle adjustment against Ceres, on BAL problems: final cost and time, same start, same stops.

Problems are the files given, and two made here from a seed: a `street`, whose cameras see their
neighbours (sparse reduced system), and a `statue`, which all cameras see parts of (dense). Every
solver is run on one and on two threads; of Ceres' three Schur solvers the fastest counts.

Needs libceres-dev and a C++ compiler, and the release build of the example:

    cargo build --release --example solve_bundle -p evermap-algorithms
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


def run(command):
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return json.loads(out)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--work", type=Path, default=ROOT / "target/peers")
    parser.add_argument("--evermap", type=Path, default=None, help="the built example solve_bundle")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    ours = args.evermap or target / "release/examples/solve_bundle"
    ceres = args.work / "ceres_bundle"
    source = HERE / "ceres_bundle.cpp"
    if not ceres.exists() or ceres.stat().st_mtime < source.stat().st_mtime:
        flags = ["-O3", "-march=native", "-DNDEBUG", "-I/usr/include/eigen3"]
        subprocess.run(["c++", *flags, source, "-o", ceres, "-lceres", "-lglog"], check=True)
    files = list(args.files)
    for name, kind, cameras, points in [
        ("street-400-40000", street, 400, 40000),
        ("statue-100-30000", statue, 100, 30000),
    ]:
        path = args.work / f"{name}.txt"
        if not path.exists():
            write(path, kind, cameras, points, 1)
        files.append(path)
    print("| problem | observations | cost / Ceres' | evermap s, 1 thread (iterations) | 2 threads | gain "
          "| Ceres s, 1 thread (iterations) | 2 threads | time / Ceres', 1 and 2 threads |")
    print("|---|---|---|---|---|---|---|---|---|")
    for path in files:
        mine, peers = {}, {}
        for threads in (1, 2):
            mine[threads] = run([ours, path, "--threads", str(threads), "--repeat", str(args.repeat)])
            all_peers = {}
            for solver in ("dense", "sparse", "iterative"):
                all_peers[solver] = run([ceres, path, str(threads), str(args.repeat), solver])
                print(path.stem, threads, solver, all_peers[solver], file=sys.stderr)
            print(path.stem, threads, "evermap", mine[threads], file=sys.stderr)
            name = min(all_peers, key=lambda s: all_peers[s]["seconds"])
            peers[threads] = (name, all_peers[name], min(p["final_cost"] for p in all_peers.values()))
        cost = mine[1]["final_cost"] / peers[1][2]
        ratios = [mine[t]["seconds"] / peers[t][1]["seconds"] for t in (1, 2)]
        print(f"| {path.stem} | {mine[1]['observations']:,} | {cost:.5f} "
              f"| {mine[1]['seconds']:.3f} ({mine[1]['iterations']}) | {mine[2]['seconds']:.3f} "
              f"| {mine[1]['seconds'] / mine[2]['seconds']:.2f}× "
              f"| {peers[1][1]['seconds']:.3f} ({peers[1][0]}, {peers[1][1]['iterations']}) "
              f"| {peers[2][1]['seconds']:.3f} ({peers[2][0]}) | {ratios[0]:.2f}, {ratios[1]:.2f} |", flush=True)


if __name__ == "__main__":
    main()
