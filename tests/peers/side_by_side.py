"""Programs timed on the same work in one run, taking turns, so that whatever else the machine does hits all alike."""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import time


PEERS = pathlib.Path(__file__).resolve().parent


def compiled(name):
    """A peer that gives work to Ceres, compiled if need be."""
    sources = [PEERS / f"{name}.cpp", *PEERS.glob("*.h")]
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", PEERS.parent.parent / "target"))
    program = target / "peers" / name
    program.parent.mkdir(parents=True, exist_ok=True)
    if not program.exists() or program.stat().st_mtime < max(source.stat().st_mtime for source in sources):
        flags = ["-O3", "-march=native", "-DNDEBUG", "-I/usr/include/eigen3"]
        subprocess.run(["c++", *flags, sources[0], "-o", program, "-lceres", "-lglog"], check=True)
    return str(program)


class Contender:
    """A command that does the work once.

    `inner`: it prints {"rows": …, "seconds": …} about the work alone; otherwise its wall time counts, start included.
    `fresh`: what to do before each run, off the clock.
    """

    def __init__(self, name, command, inner=True, fresh=lambda: None, environment=None):
        self.name, self.command, self.inner, self.fresh = name, command, inner, fresh
        self.environment = {**os.environ, **(environment or {})}
        self.seconds, self.rows = [], set()

    def run(self, core):
        """Does the work once; on one core where a core is given."""
        pin = None if core is None else lambda: os.sched_setaffinity(0, {core})
        self.fresh()
        start = time.perf_counter()
        done = subprocess.run(
            self.command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=pin, env=self.environment, check=False
        )
        seconds = time.perf_counter() - start
        if done.returncode != 0:
            sys.exit(f"{self.name} failed ({done.returncode}): {' '.join(self.command)}\n{done.stderr.decode()}")
        if self.inner:
            printed = json.loads(done.stdout)
            seconds = printed["seconds"]
            self.rows.add(printed.get("rows"))
        self.seconds.append(seconds)

    @property
    def median(self):
        """Median seconds."""
        return statistics.median(self.seconds)


def race(contenders, runs, core=None):
    """Runs all in turn, each round beginning with another one; the first round warms caches and is not counted."""
    for number in range(runs + 1):
        first = number % len(contenders)
        for contender in contenders[first:] + contenders[:first]:
            contender.run(core)
        if number == 0:
            for contender in contenders:
                contender.seconds.clear()
    rows = set().union(*(contender.rows for contender in contenders)) - {None}
    if len(rows) > 1:
        sys.exit(f"not the same work: rows {({each.name: sorted(each.rows) for each in contenders})}")
    return contenders


def table(title, contenders, amount, unit):
    """A markdown table: `amount` of `unit` per second, and how much faster the first is than each."""
    ours = contenders[0]
    print(f"\n### {title}\n\n| | median s | min–max s | {unit}/s | {ours.name} is faster by |\n|---|---|---|---|---|")
    for each in contenders:
        spread = f"{min(each.seconds):.3f}–{max(each.seconds):.3f}"
        ratio = "" if each is ours else f"{each.median / ours.median:.2f}×"
        print(f"| {each.name} | {each.median:.3f} | {spread} | {amount / each.median:,.0f} | {ratio} |")
    sys.stdout.flush()


def arguments(doc):
    """The command line that all comparisons share."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--evermap", default="target/release/evermap", help="our program")
    parser.add_argument("--scan", default="target/release/examples/scan", help="our scan example")
    parser.add_argument("--folder", default="target/peers", help="where recordings are made and kept")
    parser.add_argument("--runs", type=int, default=7, help="counted rounds")
    parser.add_argument("--core", type=int, default=0, help="the core that single-core comparisons are pinned to")
    return parser
