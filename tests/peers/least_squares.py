"""Pose graphs against GTSAM and Ceres: final costs and times from the same first guess, as a table.

    pip install -r tests/peers/requirements-bench.txt; apt-get install libceres-dev
    python tests/peers/least_squares.py FOLDER_OF_G2O [--repeat 5] [--threads 1,2]

All minimise ½ Σ rᵀΩr with r the logarithm of SE(2) or SE(3); the table says whose costs differ. A time is that of the
solver alone, ordering and symbolic analysis included and reading the file not; the shortest of several runs, in turns.

evermap solves each graph twice: with the file's poses, and with its edges alone. The peers begin at the file's poses;
where it has none, at GTSAM's chordal start (LAGO on the plane), which their times leave out. evermap's include its own.
"""

import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

from side_by_side import compiled

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent

# Beyond the defaults: what made each peer fastest on these graphs. The default is always run, too.
CERES = {"Ceres LM": ["1e4", "lm"], "Ceres LM, trusting": ["1e10", "lm"], "Ceres dogleg": ["1e10", "dogleg"]}
GTSAM = ["GTSAM LM", "GTSAM GN"]
OURS = "evermap"
EDGES_ONLY = "evermap, edges only"


def example():
    """evermap's program, compiled if need be."""
    cargo = ["cargo", "build", "--release", "--example", "solve", "-p", "evermap-bench", "--message-format=json"]
    lines = subprocess.run(cargo, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout.splitlines()
    return next(message["executable"] for message in map(json.loads, lines) if message.get("executable"))


def gtsam_once(path, method):
    """One run of GTSAM in this process, which `--gtsam` makes a process of its own."""
    import gtsam  # pylint: disable=import-outside-toplevel

    spatial = "SE3:QUAT" in pathlib.Path(path).read_text(encoding="ascii")
    graph, initial = gtsam.readG2o(path, spatial)
    anchored = gtsam.NonlinearFactorGraph(graph)
    first = min(initial.keys())
    if spatial:
        anchored.add(gtsam.NonlinearEqualityPose3(first, initial.atPose3(first)))
    else:
        anchored.add(gtsam.NonlinearEqualityPose2(first, initial.atPose2(first)))
    lm = method.endswith("LM")
    params = gtsam.LevenbergMarquardtParams() if lm else gtsam.GaussNewtonParams()
    optimizer = gtsam.LevenbergMarquardtOptimizer if lm else gtsam.GaussNewtonOptimizer
    start = time.perf_counter()
    try:
        solver = optimizer(anchored, initial, params)
        final = solver.optimize()
    except RuntimeError:
        return {"initial_cost": graph.error(initial), "failed": True}
    seconds = time.perf_counter() - start
    costs = {"initial_cost": graph.error(initial), "final_cost": graph.error(final)}
    return {**costs, "iterations": solver.iterations(), "seconds": seconds}


def with_poses(path, folder):
    """The file, or where it has edges alone, a copy with the poses that GTSAM begins such graphs at."""
    text = pathlib.Path(path).read_text(encoding="ascii")
    if "VERTEX" in text:
        return path
    import gtsam  # pylint: disable=import-outside-toplevel

    spatial = "SE3:QUAT" in text
    graph, _ = gtsam.readG2o(path, spatial)
    size = 6 if spatial else 3
    noise = gtsam.noiseModel.Unit.Create(size)
    factors = [graph.at(index) for index in range(graph.size())]
    first = min(min(factor.keys()) for factor in factors)
    if spatial:
        graph.add(gtsam.PriorFactorPose3(first, gtsam.Pose3(), noise))
        poses = gtsam.InitializePose3.initialize(graph)
    else:
        # LAGO takes no information off the diagonal.
        plain = gtsam.NonlinearFactorGraph()
        for factor in factors:
            plain.add(gtsam.BetweenFactorPose2(*factor.keys(), factor.measured(), noise))
        plain.add(gtsam.PriorFactorPose2(first, gtsam.Pose2(), noise))
        poses = gtsam.lago.initialize(plain)
    lines = []
    for key in poses.keys():
        if spatial:
            pose = poses.atPose3(key)
            q = pose.rotation().toQuaternion()
            lines.append(["VERTEX_SE3:QUAT", key, *pose.translation(), q.x(), q.y(), q.z(), q.w()])
        else:
            pose = poses.atPose2(key)
            lines.append(["VERTEX_SE2", key, pose.x(), pose.y(), pose.theta()])
    started = pathlib.Path(folder) / pathlib.Path(path).name
    started.write_text("".join(" ".join(map(str, line)) + "\n" for line in lines) + text, encoding="ascii")
    return str(started)


def run(command, threads):
    """A program's JSON, on as many cores as it has threads."""
    cores = sorted(os.sched_getaffinity(0))[-threads:]
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads), "OPENBLAS_NUM_THREADS": str(threads)}
    pin = lambda: os.sched_setaffinity(0, cores)  # noqa: E731
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, preexec_fn=pin, env=environment)
    return json.loads(done.stdout)


def measure(path, started, programs, threads, repeat):
    """Every solver on one graph, in turns; the fastest run of each. The peers read `started`."""
    ours, ceres = programs
    commands = {OURS: [ours, path, "--threads", str(threads)]}
    commands[EDGES_ONLY] = [*commands[OURS], "--edges-only"]
    for name, how in CERES.items() if ceres else ():
        commands[name] = [ceres, started, str(threads), "1", *how]
    for name in GTSAM:
        commands[name] = [sys.executable, __file__, "--gtsam", name, started]
    best = {}
    for _ in range(repeat):
        for name, command in commands.items():
            result = run(command, threads)
            if name not in best or result.get("seconds", 0) < best[name].get("seconds", 0):
                best[name] = result
    return best


def rows(graph, threads, best):
    """Two lines of the table, and whether both goals are met."""
    peers = {name: result for name, result in best.items() if name in (*CERES, *GTSAM) and "failed" not in result}
    cost = min(result["final_cost"] for result in peers.values())
    # A peer that ends in a worse minimum has not done the same work.
    same = {name: result for name, result in peers.items() if result["final_cost"] <= 1.001 * cost}
    fastest = min(same, key=lambda name: same[name]["seconds"])
    lines, met = [], True
    for name, start in ((OURS, "poses"), (EDGES_ONLY, "edges")):
        ours = best[name]
        ratios = ours["final_cost"] / cost, ours["seconds"] / same[fastest]["seconds"]
        cells = [graph, threads, start, f"{ours['given_cost']:.6g}", f"{ours['initial_cost']:.6g}"]
        cells += [f"{ours['final_cost']:.7g}", f"{cost:.7g}", f"{ratios[0]:.6f}"]
        cells += [ours["optimality"], ours["iterations"], f"{1e3 * ours['seconds']:.2f}"]
        cells += [f"{1e3 * same[fastest]['seconds']:.2f} ({fastest}, {same[fastest]['iterations']})", f"{ratios[1]:.2f}"]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
        met &= ratios[0] <= 1.001 and ratios[1] <= 1.0
    return lines, met


def main():
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("path")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--threads", default="1,2")
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("--program", help="evermap's example `solve`, already built")
    parser.add_argument("--no-ceres", action="store_true", help="where Ceres is not installed")
    parser.add_argument("--gtsam", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.gtsam:
        print(json.dumps(gtsam_once(given.path, given.gtsam)))
        return
    programs = given.program or example(), None if given.no_ceres else compiled("ceres_pose_graph")
    print("| graph | threads | given | its cost | at the start | after | best peer | ratio | proven | iterations | ms | fastest peer, ms | ratio |")
    print("|---|--:|---|--:|--:|--:|--:|--:|---|--:|--:|---|--:|")
    met = True
    paths = sorted(pathlib.Path(given.path).glob("*.g2o"), key=lambda path: path.stat().st_size)
    with tempfile.TemporaryDirectory() as folder:
        for path in paths:
            started = with_poses(str(path), folder)
            for threads in map(int, given.threads.split(",")):
                best = measure(str(path), started, programs, threads, given.repeat)
                lines, good = rows(path.stem, threads, best)
                print(*lines, sep="\n", flush=True)
                met &= good
                if given.verbose:
                    print(json.dumps(best, indent=1), file=sys.stderr)
    print(f"goals (cost ≤ 1.001×, time ≤ 1×) {'met' if met else 'NOT met'}", file=sys.stderr)


if __name__ == "__main__":
    main()
