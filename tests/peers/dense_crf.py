"""Dense random fields: evermap against pydensecrf (the reference C++ of Krähenbühl and Koltun), in one run.

    pip install -r tests/peers/requirements.txt -r tests/peers/requirements-bench.txt
    python tests/peers/dense_crf.py ../shared [--repeat 5]

The first argument is a folder with `worlds/street_small` and `data/camvid`.

Both are given the same image, the same costs and the same kernels, and each one core; the least processor time of
several runs in turns counts, lattices included. Energies are the reference's own: its divergence of both results, and of both labellings.
Goals: divergence and energy at most the reference's, 99 % of labels equal, 4 times as fast.
"""

import argparse
import io
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
from PIL import Image

ROOT = pathlib.Path(__file__).resolve().parents[2]
SIZE = WIDTH, HEIGHT = 1024, 333
CLASSES = 9
ITERATIONS = 10
# What the reference's example has: weight, deviation in the image, deviation in colour.
SMOOTHNESS = {"compat": 3, "sxy": 3}
APPEARANCE = {"compat": 10, "sxy": 80, "srgb": 13}


def example():
    """evermap's program, compiled if need be."""
    cargo = ["cargo", "build", "--release", "--example", "dense_crf", "-p", "evermap-bench", "--message-format=json"]
    lines = subprocess.run(cargo, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout.splitlines()
    return next(message["executable"] for message in map(json.loads, lines) if message.get("executable"))


def noisy(labels, seed):
    """Labels of which three in ten are another class, in blots of 4 pixels, as a labeller would err."""
    chance = np.random.default_rng(seed)
    small = (labels.shape[0] // 4 + 1, labels.shape[1] // 4 + 1)
    wrong = np.kron(chance.random(small) < 0.3, np.ones((4, 4), bool))[: labels.shape[0], : labels.shape[1]]
    other = np.kron(chance.integers(1, CLASSES, small), np.ones((4, 4), int))[: labels.shape[0], : labels.shape[1]]
    return np.where(wrong, (labels + other) % CLASSES, labels)


def panorama(shared):
    """A simulated panorama with its noisy labels, from a log."""
    from mcap.reader import make_reader  # pylint: disable=import-outside-toplevel

    found = {}
    with open(shared / "worlds/street_small/visit_a/visit_a.mcap", "rb") as log:
        topics = ["/panorama/image/compressed", "/panorama/labels_noisy"]
        for _, channel, message in make_reader(log).iter_messages(topics=topics):
            starts = [message.data.find(magic) for magic in (b"\xff\xd8\xff", b"\x89PNG")]
            start = min(at for at in starts if at >= 0)
            found.setdefault(channel.topic, Image.open(io.BytesIO(message.data[start:])))
            if len(found) == len(topics):
                break
    image, labels = (np.array(found[topic]) for topic in topics)
    return image[..., :3], labels


def photograph(shared):
    """A frame of CamVid brought to a panorama's size, its labels made noisy."""
    path = sorted((shared / "data/camvid/images").rglob("*.png"))[0]
    labels = next((shared / "data/camvid/labels11").rglob(path.name))
    image = Image.open(path).convert("RGB").resize(SIZE, Image.BICUBIC)
    labels = np.array(Image.open(labels).resize(SIZE, Image.NEAREST)).astype(int)
    return np.array(image), noisy(labels % CLASSES, 1)


def reference(image, costs):
    """The reference's field."""
    import pydensecrf.densecrf as peer  # pylint: disable=import-outside-toplevel

    field = peer.DenseCRF2D(WIDTH, HEIGHT, CLASSES)
    field.setUnaryEnergy(costs)
    field.addPairwiseGaussian(**SMOOTHNESS)
    field.addPairwiseBilateral(**APPEARANCE, rgbim=image)
    return field


def divergence(field, marginals):
    """The reference's opinion of marginals, classes outermost."""
    holder = field.startInference()[0]
    np.asarray(holder)[:] = marginals
    return field.klDivergence(holder)


def energy(field, costs, labels):
    """The Gibbs energy of a labelling: the reference's divergence of a certain one counts every pair twice."""
    certain = np.zeros((CLASSES, labels.size), np.float32)
    certain[labels, np.arange(labels.size)] = 1.0
    own = float((certain * costs).sum(dtype=np.float64))
    return 0.5 * (own + divergence(field, certain))


def pinned():
    """To the last core."""
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-1:])


def measure(program, image, costs, repeat):
    """Seconds and marginals of both, and the reference's field."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        image.tofile(folder / "image")
        np.ascontiguousarray(costs.T).tofile(folder / "costs")
        given = {"width": WIDTH, "height": HEIGHT, "classes": CLASSES, "iterations": ITERATIONS, "repeat": 1}
        given |= {name: folder / name for name in ("image", "costs", "out")}
        command = [program] + [str(word) for name, value in given.items() for word in (f"--{name}", value)]
        ours, theirs = [], []
        for _ in range(repeat):
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, env={**os.environ, "RAYON_NUM_THREADS": "1"})
            ours.append(json.loads(done.stdout))
            start = time.process_time()
            field = reference(image, costs)
            marginals = field.inference(ITERATIONS)
            theirs.append(time.process_time() - start)
        own = np.fromfile(folder / "out", np.float32).reshape(-1, CLASSES).T
    best = min(ours, key=lambda run: run["seconds"])
    return best, own, min(theirs), np.array(marginals), field


def row(name, program, image, labels, repeat):
    """A line of the table, and whether the goals are met."""
    from pydensecrf.utils import unary_from_labels  # pylint: disable=import-outside-toplevel

    image = np.ascontiguousarray(image, np.uint8)
    costs = np.ascontiguousarray(unary_from_labels(labels.astype(int), CLASSES, 0.7, zero_unsure=False))
    best, own, seconds, marginals, field = measure(program, image, costs, repeat)
    ours, theirs = own.argmax(0), marginals.argmax(0)
    equal = (ours == theirs).mean()
    divergences = divergence(field, own), divergence(field, marginals)
    energies = energy(field, costs, ours), energy(field, costs, theirs)
    ratio = seconds / best["seconds"]
    excess = [(own - other) / abs(other) for own, other in (divergences, energies)]
    cells = [name, f"{1e3 * best['seconds']:.0f} ({1e3 * best['prepared']:.0f})", f"{1e3 * seconds:.0f}", f"**{ratio:.1f}×**"]
    cells += [f"{100 * equal:.3f} %", f"{divergences[0]:.8g}", f"{divergences[1]:.8g}", f"{excess[0]:+.1e}"]
    cells += [f"{energies[0]:.8g}", f"{energies[1]:.8g}", f"{excess[1]:+.1e}"]
    # Single precision: the reference's own sums are not better than that.
    return "| " + " | ".join(cells) + " |", equal >= 0.99 and ratio >= 4.0 and max(excess) <= 1e-6


def main():
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("shared", type=pathlib.Path, help="the folder with `worlds` and `data`")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--program", help="evermap's example `dense_crf`, already built")
    given = parser.parse_args()
    program = given.program or example()
    pinned()
    print("| image | ms (lattices) | reference, ms | faster | equal labels | divergence | reference's | excess | energy | reference's | excess |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    met = True
    for name, work in {"simulated panorama": panorama, "photograph": photograph}.items():
        line, good = row(name, program, *work(given.shared), given.repeat)
        print(line, flush=True)
        met &= good
    print(f"goals (energies ≤ 1×, labels ≥ 99 %, time ≤ 1/4) {'met' if met else 'NOT met'}", file=sys.stderr)


if __name__ == "__main__":
    main()
