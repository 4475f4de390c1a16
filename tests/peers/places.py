"""Places found again by their words, against OpenCV's matchers and ABoW, on the same descriptors: a table.

    pip install -r tests/peers/requirements.txt -r tests/peers/requirements-bench.txt
    python tests/peers/places.py STREET [--views 1300,13000]

STREET holds `visit_a` and `visit_b` as `evermap simulate street` writes them: an MCAP with panoramas and the true
`trajectory.tum`. All use the features that evermap finds. ABoW is DBoW in Rust, compiled on first use (`cargo`); it
knows 256 bits only, so it and a second run of ours get the first half of each descriptor. OpenCV's brute force counts
what passes the ratio test, its LSH index lets each feature vote for the view of its nearest neighbour. Everything runs
on one thread, whose time on a core is what counts. Recall@1 is within 5 m; the discriminative power is that of paper 2, section V-B, each query's distances
taken from 0 to 1. Both are computed here for everyone, and compared with what evermap says of itself.
"""

import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import cv2
import numpy as np
from mcap_ros2.reader import read_ros2_messages

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
BYTES = 64
RATIO = 0.8
WITHIN_M = 5.0
VOCABULARIES = [(10, 5), (8, 4)]


def example(name, package):
    """One of evermap's programs, compiled if need be."""
    cargo = ["cargo", "build", "--release", "--example", name, "-p", package, "--message-format=json"]
    lines = subprocess.run(cargo, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout.splitlines()
    return next(message["executable"] for message in map(json.loads, lines) if message.get("executable"))


def abow_program():
    """ABoW behind a command line, compiled if need be."""
    folder = pathlib.Path(tempfile.gettempdir()) / f"abow_places.{os.getuid()}"
    (folder / "src").mkdir(parents=True, exist_ok=True)
    manifest = '[package]\nname = "abow_places"\nversion = "0.1.0"\nedition = "2021"\n[workspace]\n'
    manifest += '[dependencies]\nabow = { version = "=0.4.2", default-features = false }\nserde_json = "1"\n'
    (folder / "Cargo.toml").write_text(manifest, encoding="ascii")
    (folder / "src" / "main.rs").write_bytes((HERE / "abow_places.rs").read_bytes())
    environment = {**os.environ, "CARGO_TARGET_DIR": str(folder / "target"), "RUSTFLAGS": "-C target-cpu=native"}
    subprocess.run(["cargo", "build", "--release", "--quiet"], cwd=folder, check=True, env=environment)
    return folder / "target" / "release" / "abow_places"


class Views:
    """What was seen, and where from."""

    def __init__(self, descriptors, positions):
        self.descriptors = descriptors
        self.positions = positions

    @classmethod
    def read(cls, name):
        """Of a file of the example `describe`, with the positions beside it."""
        data = pathlib.Path(f"{name}.features").read_bytes()
        descriptors, at = [], 0
        while at < len(data):
            count = int.from_bytes(data[at : at + 4], "little")
            own = np.frombuffer(data, np.uint8, count * BYTES, at + 4)
            descriptors.append(own.reshape(count, BYTES))
            at += 4 + count * BYTES
        return cls(descriptors, np.loadtxt(f"{name}.positions", ndmin=2))

    def write(self, name):
        """As `read` wants it."""
        with open(f"{name}.features", "wb") as file:
            for own in self.descriptors:
                file.write(len(own).to_bytes(4, "little") + own.tobytes())
        np.savetxt(f"{name}.positions", self.positions)
        return name

    def every(self, step, first=0):
        """Every so manieth view."""
        return Views(self.descriptors[first::step], self.positions[first::step])

    def half(self):
        """256 bits of each descriptor, and zeros."""
        keep = (np.arange(BYTES) < BYTES // 2).astype(np.uint8)
        return Views([own * keep for own in self.descriptors], self.positions)

    def streets(self, views, strange, noise=40):
        """So many views: this street again and again, a kilometre apart. Every descriptor after the first street has
        `noise` bits at chance; where they are `strange`, a street has looks of its own besides."""
        random = np.random.default_rng(1)
        descriptors, positions = [], []
        while len(descriptors) < views:
            street = len(descriptors) // len(self.descriptors)
            mask = random.integers(0, 256, BYTES, np.uint8) if strange and street else np.zeros(BYTES, np.uint8)
            for own, position in zip(self.descriptors, self.positions):
                if street:
                    own = own ^ mask
                    bits = random.integers(0, 8 * BYTES, (len(own), noise))
                    for bit in bits.T:
                        own[np.arange(len(own)), bit // 8] ^= (1 << bit % 8).astype(np.uint8)
                descriptors.append(own)
                positions.append(position + [0, 0, 1000 * street])
        return Views(descriptors[:views], np.array(positions[:views]))


def panoramas(session):
    """A session's panoramas, and where they were taken."""
    text = (session / "trajectory.tum").read_text(encoding="utf-8").splitlines()
    truth = np.array([line.split() for line in text if not line.startswith("#")])
    stamps = [int(second) * 10**9 + int(part) for second, part in (row[0].split(".") for row in truth)]
    where = dict(zip(stamps, truth[:, 1:4].astype(float)))
    log = str(next(session.glob("*.mcap")))
    for message in read_ros2_messages(log, topics=["/panorama/image/compressed"]):
        stamp = message.ros_msg.header.stamp
        data = np.frombuffer(bytes(message.ros_msg.data), np.uint8)
        yield cv2.imdecode(data, cv2.IMREAD_COLOR), where[stamp.sec * 10**9 + stamp.nanosec]


def crop(panorama, size=(640, 480)):
    """What a camera of 90 degrees sees ahead."""
    height, width = panorama.shape[:2]
    u, v = np.meshgrid(np.arange(size[0]) - (size[0] - 1) / 2, np.arange(size[1]) - (size[1] - 1) / 2)
    x, y = u / (size[0] / 2), v / (size[0] / 2)
    per_rad = width / (2 * np.pi)
    column = (width - 1) / 2 + per_rad * np.arctan2(x, 1)
    row = (height - 1) / 2 + per_rad * np.arcsin(y / np.sqrt(x * x + y * y + 1))
    return cv2.remap(panorama, column.astype(np.float32), row.astype(np.float32), cv2.INTER_CUBIC)


def described(street, describe, folder):
    """The features of both visits' panoramas and of crops of the second."""
    for visit in ["visit_a", "visit_b"]:
        where = []
        for number, (image, position) in enumerate(panoramas(street / visit)):
            where.append(position)
            kinds = {visit: image, f"{visit}_crops": crop(image)}
            for name, picture in kinds.items():
                (folder / name).mkdir(exist_ok=True)
                cv2.imwrite(str(folder / name / f"{number:06}.png"), picture)
        for name in [visit, f"{visit}_crops"]:
            np.savetxt(folder / f"{name}.positions", where)
            subprocess.run([describe, folder / name, folder / f"{name}.features"], check=True)
    names = ["visit_a", "visit_b", "visit_a_crops", "visit_b_crops"]
    return {name: Views.read(folder / name) for name in names}


def measures(distances, queries, views):
    """Recall@1 and discriminative power."""
    apart = np.linalg.norm(queries[:, None] - views[None], axis=2)
    best = distances == distances.min(axis=1, keepdims=True)
    recall = np.mean((best & (apart <= WITHIN_M)).sum(1) / best.sum(1))
    least, most = distances.min(1, keepdims=True), distances.max(1, keepdims=True)
    scaled = np.where(most > least, (distances - least) / np.where(most > least, most - least, 1), 1)
    order = np.argsort(apart, axis=1, kind="stable")
    right = np.take_along_axis(scaled, order[:, :3], 1).mean()
    wrong = np.take_along_axis(scaled, order[:, 3:], 1).mean()
    return recall, wrong / right if right > 0 else np.inf


def command(program, map_name, query_name, branching, depth):
    """A program's report and distances."""
    out = f"{query_name}.distances"
    arguments = [map_name, query_name, "--branching", str(branching), "--depth", str(depth), "--repeat", "20"]
    core = {max(os.sched_getaffinity(0))}
    done = subprocess.run(
        [program, *map(str, arguments), "--out", out],
        check=True,
        stdout=subprocess.PIPE,
        preexec_fn=lambda: os.sched_setaffinity(0, core),
    )
    report = json.loads(done.stdout)
    return report, np.fromfile(out, np.float32).reshape(report["queries"], report["views"]).astype(float)


def brute_force(views, queries):
    """OpenCV, all against all."""
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)

    def score(query, view):
        pairs = matcher.knnMatch(query, view, k=2) if len(query) and len(view) > 1 else []
        return sum(best.distance < RATIO * other.distance for best, other in pairs) / max(len(query), 1)

    start = time.thread_time()
    scores = np.array([[score(query, view) for view in views] for query in queries])
    return 1 - scores, (time.thread_time() - start) / len(queries)


def hashing(views, queries):
    """OpenCV's index for binary descriptors over all features of the map."""
    owner = np.repeat(np.arange(len(views)), [len(view) for view in views])
    index = cv2.flann.Index(np.concatenate(views), {"algorithm": 6, "table_number": 6, "key_size": 20, "multi_probe_level": 1}, 9)
    scores = np.zeros((len(queries), len(views)))
    start = time.thread_time()
    for query, row in zip(queries, scores):
        found, _ = index.knnSearch(query, 1, params={})
        found = found[(found >= 0) & (found < len(owner))]
        row[:] = np.bincount(owner[found], minlength=len(views)) / max(len(query), 1)
    return 1 - scores, (time.thread_time() - start) / len(queries)


def row(task, method, views, report):
    """A line of the table."""
    seconds, recall, power, trained = report
    trained = "" if trained is None else f"{trained:.2f}"
    milliseconds = f"{1e3 * seconds:.3f}"
    print(f"| {task} | {method} | {views} | {recall:.3f} | {power:.2f} | {milliseconds} | {trained} |", flush=True)


def words(programs, folder, task, views, queries):
    """Ours at full length; ours and ABoW on half of it."""
    ours, abow = programs
    runs = [("evermap", ours, views, queries)]
    if abow:
        halves = views.half(), queries.half()
        runs += [("evermap, 256 bits", ours, *halves), ("ABoW, 256 bits", abow, *halves)]
    for name, program, its_views, its_queries in runs:
        files = its_views.write(folder / "map"), its_queries.write(folder / "queries")
        for branching, depth in VOCABULARIES:
            report, distances = command(program, *files, branching, depth)
            recall, power = measures(distances, queries.positions, views.positions)
            said = report.get("found")
            if said and (abs(said["recall"] - recall) > 1e-6 or abs((said["power"] or np.inf) - power) > 1e-3 * power):
                sys.exit(f"evermap says {said}, and this script {recall}, {power}")
            seconds = 1e-6 * (report["words_us"] + report["search_us"])
            method = f"{name}, K={branching} L={depth}"
            row(task, method, len(distances[0]), (seconds, recall, power, report["training_s"]))


def main():
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("street", type=pathlib.Path)
    parser.add_argument("--views", default="", help="sizes of larger maps, made of streets side by side")
    parser.add_argument("--describe", help="evermap's example `describe`, already built")
    parser.add_argument("--relocate", help="evermap's example `relocate`, already built")
    parser.add_argument("--no-abow", action="store_true")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    describe = given.describe or example("describe", "evermap-vision")
    ours = given.relocate or example("relocate", "evermap-bench")
    programs = ours, None if given.no_abow else abow_program()
    print("| task | method | views | recall@1 | power | ms per query | training, s |")
    print("|---|---|--:|--:|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        seen = described(given.street, describe, folder)
        first, second = seen["visit_a"], seen["visit_b"]
        tasks = {
            "second visit": (first, second),
            "distant, 3 m": (first.every(4), first.every(4, 2)),
            "distant, 3 m, second visit": (first.every(4), second.every(4, 2)),
            "distant, 6 m": (first.every(8), first.every(8, 4)),
            "distant, 6 m, second visit": (first.every(8), second.every(8, 4)),
            "90° crops": (first, seen["visit_a_crops"]),
            "90° crops, second visit": (first, seen["visit_b_crops"]),
        }
        for task, (views, queries) in tasks.items():
            words(programs, folder, task, views, queries)
            for name, method in [("OpenCV brute force", brute_force), ("OpenCV LSH", hashing)]:
                distances, seconds = method(views.descriptors, queries.descriptors)
                figures = measures(distances, queries.positions, views.positions)
                row(task, name, len(views.descriptors), (seconds, *figures, None))
        for size in filter(None, given.views.split(",")):
            for strange in [True, False]:
                many = first.streets(int(size), strange)
                task = "streets of their own looks" if strange else "streets that look alike"
                words((ours, None), folder, task, many, second)


if __name__ == "__main__":
    main()
