"""Our own criterion benches at another commit and here, on the same machine.

    against.py REV [BENCH ...]

`make bench BASE=REV` runs it. REV is built in a worktree of its own under target/base, and is measured before and after this
tree: what differs between those two runs is noise. A bench has moved where the 95 % interval of its mean lies 2 % or more
beyond both.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

NOISE = 0.02
RUNS = ("base", "here", "again")
TREE = Path(__file__).resolve().parents[2]
BASE = TREE / "target" / "base"


def checked_out(revision):
    """The folder of a worktree at a revision."""
    source = BASE / "source"
    if source.exists():
        subprocess.run(["git", "-C", source, "checkout", "--quiet", "--detach", revision], check=True)
    else:
        subprocess.run(["git", "-C", TREE, "worktree", "prune"], check=True)
        subprocess.run(["git", "-C", TREE, "worktree", "add", "--quiet", "--detach", source, revision], check=True)
    return source


def bench(folder, target, names, *words):
    """Runs benches of a tree; all write into one place."""
    chosen = [word for name in names for word in ("--bench", name)] or ["--benches"]
    command = ["cargo", "bench", "--workspace", "--locked", *chosen, "--", *words]
    places = {"CARGO_TARGET_DIR": str(target), "CRITERION_HOME": str(BASE / "criterion")}
    subprocess.run(command, cwd=folder, env={**os.environ, **places}, check=True, stdout=sys.stderr)


def measured(bench, run):
    """The mean of a bench and its interval, in one run."""
    mean = json.loads((bench / run / "estimates.json").read_text())["mean"]
    interval = mean["confidence_interval"]
    return mean["point_estimate"], interval["lower_bound"], interval["upper_bound"]


def rows():
    """Of each bench in all runs: its name, its change from the mean of both runs of the base, how much these differ, verdict."""
    for found in sorted((BASE / "criterion").rglob("again/estimates.json")):
        bench = found.parent.parent
        if not all((bench / run / "estimates.json").exists() for run in RUNS):
            continue
        before, here, again = (measured(bench, run) for run in RUNS)
        base = (before[0] + again[0]) / 2
        moved = verdict(here[1] / max(before[2], again[2]) - 1, here[2] / min(before[1], again[1]) - 1)
        yield str(bench.relative_to(BASE / "criterion")), here[0] / base - 1, again[0] / before[0] - 1, moved


def verdict(low, high):
    """In a word."""
    if low > NOISE:
        return "**slower**"
    return "faster" if high < -NOISE else ""


def main():
    """Runs both, prints the table; fails where something became slower."""
    revision, *names = sys.argv[1:]
    revision = subprocess.run(["git", "rev-parse", "--verify", f"{revision}^{{commit}}"], check=True, capture_output=True, text=True).stdout.strip()
    source = checked_out(revision)
    for run, folder, target in zip(RUNS, (source, TREE, source), (BASE / "target", TREE / "target", BASE / "target")):
        bench(folder, target, names, "--save-baseline", run)
    print(f"| bench | against {revision[:12]} | {revision[:12]} again | |\n|---|---|---|---|")
    slower = 0
    for name, change, noise, moved in rows():
        slower += moved == "**slower**"
        print(f"| {name} | {100 * change:+.1f} % | {100 * noise:+.1f} % | {moved} |")
    sys.exit(1 if slower else 0)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main()
