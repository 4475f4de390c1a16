"""Functions for the steps of plans in this folder."""

import math

import pyarrow as pa
import pyarrow.compute as pc


def map_frames(poses, gap_m=5.0):
    """Poses farther than gap_m from every frame become frames: the operator of this name, for a first version."""
    poses = poses.sort_by([("stamp", "ascending"), ("session", "ascending")])
    axes = [pc.struct_field(poses["map_from_vehicle"], axis).to_pylist() for axis in "xyz"]
    frames = []
    for row, here in enumerate(zip(*axes)):
        away = (math.sqrt(sum((a - b) * (a - b) for a, b in zip(frame, here))) for _, frame in frames)
        if min(away, default=math.inf) > gap_m:
            frames.append((row, here))
    made = poses.take([row for row, _ in frames])
    return {
        "site": made["site"],
        "frame": pa.array(range(len(frames)), pa.uint32()),
        "session": made["session"],
        "stamp": made["stamp"],
        "map_from_frame": made["map_from_vehicle"],
        "moved_m": pa.nulls(len(frames), pa.float64()),
        "moved_rad": pa.nulls(len(frames), pa.float64()),
    }


def speeds_kmh(speeds, least_mps=0.0):
    """Speeds in another unit, of what drives."""
    drives = speeds.filter(pc.greater_equal(pc.abs(speeds["speed_mps"]), least_mps))
    rows = {
        "site": drives["site"],
        "session": drives["session"],
        "stamp": drives["stamp"],
        "speed_kmh": pc.multiply(drives["speed_mps"], 3.6),
    }
    return rows, {"speed of who stands": len(speeds) - len(drives)}


def image_files(frames):
    """What each image is encoded as, and its size."""
    kinds = {b"\xff\xd8": "jpeg", b"\x89P": "png"}
    images = frames["image_pixels"].to_pylist()
    return {
        "site": frames["site"],
        "session": frames["session"],
        "camera": frames["camera"],
        "stamp": frames["stamp"],
        "kind": [kinds.get(image[:2]) for image in images],
        "file_bytes": [len(image) for image in images],
    }


def drawn(speeds):
    """No function of its rows."""
    import random

    return {"x": [random.random() for _ in range(len(speeds))]}


def numbered(speeds):
    """No function of each row."""
    return {"x": [float(row) for row in range(len(speeds))]}


def digits(speeds):
    """Whole numbers that no number of floating point is."""
    return {"x": [2**53 + 1 for _ in range(len(speeds))]}


def of_others(speeds, column, name=None):
    """Rows that say they are of another session or site."""
    rows = {column: speeds[column].to_pylist() for column in ("site", "session")}
    return {**rows, column: rows[column][:-1] + [name]}


def nameless(speeds):
    return {"stamp": speeds["stamp"]}
