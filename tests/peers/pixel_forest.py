"""A random forest's predictions against scikit-learn's: the same trees on the same features, on one core, as a table.

    pip install -r tests/peers/requirements-bench.txt
    python tests/peers/pixel_forest.py ../shared/data/camvid [--trees 48] [--samples 172800] [--repeat 5]

scikit-learn learns the forest from pixels of CamVid's images, which are described by evermap. Both then classify as many
other samples as an image of 480 x 360 has pixels. A time is that of a processor for prediction alone, the least of several, in turns;
scikit-learn is given its samples as the 32-bit numbers that it works with, so that it need not convert them.
"""

import argparse
import json
import os
import pathlib
import subprocess
import tempfile
import time

import numpy as np
from sklearn.ensemble import RandomForestClassifier

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent


def example(name):
    """One of evermap's examples, compiled if need be."""
    cargo = ["cargo", "build", "--release", "--example", name, "-p", "evermap-bench", "--message-format=json"]
    lines = subprocess.run(cargo, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout.splitlines()
    found = [message["executable"] for message in map(json.loads, lines) if message.get("executable")]
    return found[-1]


def exported(forest):
    """The trees as lists."""
    trees = []
    for estimator in forest.estimators_:
        tree = estimator.tree_
        trees.append(
            {
                "feature": tree.feature.tolist(),
                "threshold": tree.threshold.tolist(),
                "left": tree.children_left.tolist(),
                "right": tree.children_right.tolist(),
                "value": tree.value[:, 0, :].tolist(),
            }
        )
    return {"dimensions": forest.n_features_in_, "classes": len(forest.classes_), "trees": trees}


def main():
    """Learns, exports, predicts on both sides, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("camvid")
    parser.add_argument("--trees", type=int, default=48)
    parser.add_argument("--samples", type=int, default=480 * 360)
    parser.add_argument("--repeat", type=int, default=5)
    arguments = parser.parse_args()
    programs = {name: os.environ.get(f"EVERMAP_{name.upper()}") or example(name) for name in ("camvid", "forest")}
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-1:])
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        subprocess.run([programs["camvid"], arguments.camvid, "--dump", str(folder)], check=True)
        labels = np.fromfile(folder / "labels.bin", dtype=np.uint8)
        values = np.fromfile(folder / "values.bin", dtype=np.uint8).reshape(len(labels), -1)
        # Every other sample to learn from; the others, as often as need be, to classify.
        learnt, other = slice(0, None, 2), slice(1, None, 2)
        forest = RandomForestClassifier(
            arguments.trees, min_samples_leaf=8, class_weight="balanced", n_jobs=1, random_state=1
        )
        forest.fit(values[learnt], labels[learnt])
        forest.set_params(n_jobs=1)
        unseen = np.resize(values[other], (arguments.samples, values.shape[1]))
        (folder / "forest.json").write_text(json.dumps(exported(forest)), encoding="ascii")
        unseen.tofile(folder / "values.bin")
        floats = np.ascontiguousarray(unseen, dtype=np.float32)
        theirs, ours = float("inf"), float("inf")
        for _ in range(arguments.repeat):
            start = time.process_time()
            expected = forest.predict_proba(floats)
            theirs = min(theirs, time.process_time() - start)
            done = subprocess.run([programs["forest"], str(folder)], check=True, stdout=subprocess.PIPE)
            ours = min(ours, json.loads(done.stdout)["seconds"])
        found = np.fromfile(folder / "scores.bin", dtype="<f4").reshape(expected.shape)
    difference = float(np.abs(found - expected).max())
    same = float((found.argmax(1) == expected.argmax(1)).mean())
    nodes = sum(estimator.tree_.node_count for estimator in forest.estimators_)
    print(f"\n{arguments.samples} samples of {values.shape[1]} features, {arguments.trees} trees of {nodes // arguments.trees} nodes\n")
    print("| program | seconds | ratio | largest difference | same class |\n|---|---|---|---|---|")
    print(f"| scikit-learn | {theirs:.3f} | 1.0 | | |")
    print(f"| evermap | {ours:.3f} | {theirs / ours:.1f} | {difference:.1e} | {100 * same:.3f} % |")


if __name__ == "__main__":
    main()
