"""Our own criterion benches at another commit and here, one after the other on the same machine.

    against.py REV [BENCH ...]

`make bench BASE=REV` runs it. REV is built in a worktree of its own under target/base. The table has the change of the mean
with its 95 % interval; what lies beyond the noise, 2 % and the interval, is said to have moved.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

NOISE = 0.02
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


def rows():
    """Name, change and its interval, of each bench that both have."""
    for found in sorted((BASE / "criterion").rglob("change/estimates.json")):
        mean = json.loads(found.read_text())["mean"]
        interval = mean["confidence_interval"]
        name = found.parent.parent.relative_to(BASE / "criterion")
        yield str(name), mean["point_estimate"], interval["lower_bound"], interval["upper_bound"]


def verdict(low, high):
    """In a word."""
    if low > NOISE:
        return "**slower**"
    return "faster" if high < -NOISE else ""


def main():
    """Runs both, prints the table; fails where something became slower."""
    revision, *names = sys.argv[1:]
    revision = subprocess.run(["git", "rev-parse", "--verify", f"{revision}^{{commit}}"], check=True, capture_output=True, text=True).stdout.strip()
    bench(checked_out(revision), BASE / "target", names, "--save-baseline", "base")
    bench(TREE, TREE / "target", names, "--baseline-lenient", "base")
    print(f"| bench | against {revision[:12]} | 95 % interval | |\n|---|---|---|---|")
    slower = 0
    for name, change, low, high in rows():
        slower += low > NOISE
        print(f"| {name} | {100 * change:+.1f} % | {100 * low:+.1f} to {100 * high:+.1f} % | {verdict(low, high)} |")
    sys.exit(1 if slower else 0)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main()
