"""Registration of panoramas: evermap (brightness and range) against small_gicp (points), from the same start.

    pip install -r tests/peers/requirements-bench.txt
    python tests/peers/registration.py ../shared/worlds/street_small [--evermap target/release/evermap]

A street with exact truth is driven twice; views of the second visit are registered with those of the first that relocation
finds, on one core. The peer is given every pixel that has range as a point, thinned as its defaults say, and begins where we
do: in the place of the map's view, as it looks. Pairs are those within 5 m of each other in truth; right are those that end
within 10 cm. Our time is that of the step `registrations`, decoding included, for each pair that it tried; the peer's is that
of `align` alone, preprocessing included. Goal: at most 150 ms a pair of 1024 by 333 pixels.
"""

import argparse
import io
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np
import small_gicp
from PIL import Image

VISITS = "visit_a", "visit_b"
NEAR_M, RIGHT_M = 5.0, 0.1


def matrix(x, y, z, qx, qy, qz, qw):
    """A pose as a matrix."""
    cross = np.array([[0, -qz, qy], [qz, 0, -qx], [-qy, qx, 0]])
    pose = np.eye(4)
    pose[:3, :3] = np.eye(3) + 2 * qw * cross + 2 * cross @ cross
    pose[:3, 3] = x, y, z
    return pose


def asked(evermap, arguments, query):
    """Rows of a query."""
    done = subprocess.run([evermap, "sql", *arguments, "--format", "json", query], check=True, stdout=subprocess.PIPE)
    return json.loads(done.stdout)


def mapped(evermap, world, folder, core):
    """The map of both visits, made on one core."""
    for visit in VISITS:
        log = world / visit / f"{visit}.mcap"
        manifest = folder / f"{visit}.yaml"
        roles = "{ label_frames: ['/panorama/labels_noisy'] }"
        manifest.write_text(f"sessions: [{{ name: {visit}, files: ['{log}'] }}]\nroles: {roles}\n")
        command = [evermap, "run", "stable_map", "--map", folder / "map", "--site", "street", "--manifest", manifest]
        command = ["taskset", "-c", str(core), *command]
        code = subprocess.run(command, stderr=subprocess.DEVNULL, check=False).returncode
        if code not in (0, 3):
            sys.exit(f"evermap run ended with {code}")
    return folder / "map"


def cameras(evermap, world):
    """Where each panorama was taken, by visit and stamp."""
    found = {}
    for visit in VISITS:
        query = "SELECT parent_from_child AS mount FROM transforms"
        mount = asked(evermap, ["--sessions", world / visit / f"{visit}.mcap"], query)[0]["mount"]
        mount = matrix(**{name: mount[name] for name in ("x", "y", "z", "qx", "qy", "qz", "qw")})
        for line in (world / visit / "trajectory.tum").read_text().splitlines():
            if not line.startswith("#"):
                stamp, *pose = line.split()
                found[visit, int(stamp.replace(".", ""))] = matrix(*map(float, pose)) @ mount
    return found


def points(view):
    """Every pixel of a view that has range, as a point of its camera (x right, y down, z ahead)."""
    distance = np.asarray(Image.open(io.BytesIO(bytes.fromhex(view["range"]))), dtype=float) * view["unit_m"]
    rows, columns = np.nonzero(distance)
    longitude = (columns - view["centre"][0]) / view["focal"][0]
    latitude = (rows - view["centre"][1]) / view["focal"][1]
    away = distance[rows, columns]
    flat = away * np.cos(latitude)
    return np.stack([flat * np.sin(longitude), away * np.sin(latitude), flat * np.cos(longitude)], axis=1)


class Tally:
    """What came of all pairs."""

    def __init__(self, name):
        self.name, self.seconds, self.away_m, self.away_deg, self.pairs, self.said = name, [], [], [], 0, 0

    def add(self, found, truth, converged):
        """A pair, by the pose that was found."""
        off = np.linalg.inv(truth) @ found
        away_m = np.linalg.norm(off[:3, 3])
        self.pairs, self.said = self.pairs + 1, self.said + converged
        if converged and away_m <= RIGHT_M:
            self.away_m.append(away_m)
            self.away_deg.append(np.degrees(np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1))))

    def row(self):
        """Of the table."""
        away = f"{1000 * statistics.median(self.away_m):.1f} mm, {statistics.median(self.away_deg):.3f}°"
        seconds = f"{1000 * statistics.mean(self.seconds):.0f}"
        return f"| {self.name} | {self.pairs} | {self.said} | {len(self.away_m)} | {away} | {seconds} |"


def main():
    """Registers all pairs and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("world", type=pathlib.Path, help="the folder of a street with two visits")
    parser.add_argument("--evermap", default="target/release/evermap", help="our program")
    parser.add_argument("--map", type=pathlib.Path, help="a map that was made of it already, on one core")
    parser.add_argument("--core", type=int, default=0, help="the core that both are pinned to")
    given = parser.parse_args()
    evermap = os.path.abspath(given.evermap)
    world = given.world.absolute()
    with tempfile.TemporaryDirectory() as temporary:
        made = given.map or mapped(evermap, world, pathlib.Path(temporary), given.core)
        os.sched_setaffinity(0, {given.core})
        at, ask = cameras(evermap, world), lambda query: asked(evermap, ["--map", made], query)
        clouds = {
            (view["session"], view["at"]): points(view)
            for view in ask("SELECT session, CAST(stamp AS BIGINT) AS at, focal, centre, range, unit_m FROM spheres")
        }
        found = ask(
            "SELECT session, CAST(stamp AS BIGINT) AS at, map_session, CAST(map_stamp AS BIGINT) AS map_at, state,"
            " map_view_from_view AS pose FROM registrations"
        )
        ours = Tally("evermap, brightness and range")
        kinds = {kind: Tally(f"small_gicp, {kind}") for kind in ("ICP", "PLANE_ICP", "GICP")}
        took = ask("SELECT sum(seconds) AS s FROM runs WHERE step = 'registrations' AND NOT cached")[0]["s"]
        ours.seconds = [took / len(found)]
        for row in found:
            one, other = (row["map_session"], row["map_at"]), (row["session"], row["at"])
            truth = np.linalg.inv(at[one]) @ at[other]
            if np.linalg.norm(truth[:3, 3]) > NEAR_M:
                continue
            pose = np.eye(4) if row["pose"] is None else matrix(**row["pose"])
            ours.add(pose, truth, row["state"] == "converged")
            for kind, tally in kinds.items():
                start = time.perf_counter()
                result = small_gicp.align(clouds[one], clouds[other], registration_type=kind)
                tally.seconds.append(time.perf_counter() - start)
                tally.add(result.T_target_source, truth, bool(result.converged))
    print("| | pairs within 5 m | said to have converged | right to 10 cm | of those, off at the median | ms a pair |")
    print("|---|---|---|---|---|---|")
    for tally in [ours, *kinds.values()]:
        print(tally.row())


if __name__ == "__main__":
    main()
