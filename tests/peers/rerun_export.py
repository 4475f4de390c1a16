"""Opens `evermap export --format mcap` in Rerun: its checker, and its reader by entity.

    rerun_export.py MAP [EVERMAP]

Every message of the export must come out of Rerun's reader, under its topic, and as what Rerun draws where it knows the
message: images, cameras, transforms, points, poses. Prints a table; fails where the checker finds fault or a count differs.
"""

import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from rerun.chunk import McapReader

EVERMAP = Path(__file__).parents[2] / "target/release/evermap"

# The component that Rerun makes of each message; it keeps others as they are, and draws nothing of them.
DRAWN = {
    "foxglove.CompressedImage": "EncodedImage:blob",
    "foxglove.CameraCalibration": "Pinhole:image_from_camera",
    "foxglove.FrameTransform": "Transform3D:translation",
    "foxglove.PointCloud": "Points3D:positions",
    "foxglove.PosesInFrame": "InstancePoses3D:translations",
    "foxglove.LocationFix": "GeoPoints:positions",
}


def messages(path):
    """How many messages each topic has, and of which schema."""
    counts, schemas = Counter(), {}
    with open(path, "rb") as file:
        for schema, channel, _ in make_reader(file, validate_crcs=True).iter_messages():
            counts[channel.topic] += 1
            schemas[channel.topic] = schema.name
    return counts, schemas


def rows(path):
    """How many rows each component of an entity has, as Rerun reads it."""
    counts = Counter()
    for chunk in McapReader(str(path)).stream().to_chunks():
        for name in chunk.to_record_batch().schema.names:
            counts[chunk.entity_path, name] += chunk.num_rows
    return counts


def main(map_folder, evermap=EVERMAP):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.mcap"
        subprocess.run([evermap, "export", "--map", map_folder, "--format", "mcap", "--out", path], check=True)
        checker = Path(sys.executable).parent / "rerun"
        checked = subprocess.run([checker, "mcap", "check", "--full", path], capture_output=True, text=True)
        if checked.returncode:
            sys.exit(f"rerun mcap check: {checked.stdout}{checked.stderr}")
        counts, schemas = messages(path)
        found = rows(path)
    wrong = 0
    print("| topic | message | messages | in Rerun | as |\n|---|---|---|---|---|")
    for topic in sorted(counts):
        component = DRAWN.get(schemas[topic], f"{schemas[topic]}:message")
        read = found[topic, component]
        wrong += read != counts[topic]
        print(f"| `{topic}` | {schemas[topic]} | {counts[topic]} | {read} | {component} |")
    if wrong:
        sys.exit(f"{wrong} topics differ")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(*sys.argv[1:])
