"""Opens what `evermap export` writes with the programs that it is for: COLMAP and evo.

    exports.py MAP [SESSION [EVERMAP]]     a map that the plan lifelong or car_park made

Checks that every 3D point projects, by COLMAP's own camera model, to where evermap's residuals say, and that evo reads
the trajectories. Prints what it found; fails where they disagree.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pycolmap
from evo.core import metrics, sync
from evo.tools import file_interface

EVERMAP = Path(__file__).parents[2] / "target/release/evermap"


def export(evermap, map_folder, layer, form, out, *more):
    command = [evermap, "export", layer, "--map", map_folder, "--format", form, "--out", out, *more]
    subprocess.run([str(word) for word in command], check=True)


def colmap(folder):
    model = pycolmap.Reconstruction(str(folder))
    assert model.points3D, "the map has no landmarks"
    errors = []
    for image in model.images.values():
        camera = model.cameras[image.camera_id]
        camera_from_world = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        for point in image.points2D:
            if point.has_point3D():
                seen = camera.img_from_cam(camera_from_world * model.points3D[point.point3D_id].xyz)
                errors.append(np.inf if seen is None else np.linalg.norm(seen - point.xy))
    errors = np.array(errors)
    said = np.array([point.error for point in model.points3D.values()])
    print(
        f"colmap: {len(model.cameras)} cameras, {len(model.images)} images, {len(model.points3D)} points, "
        f"{len(errors)} observations, median {np.median(errors):.3f} px (landmarks say {np.median(said):.3f} px)"
    )
    # Outliers are observations too; the median must be what evermap says it is.
    assert np.median(errors) < 1.5 * np.median(said) + 0.05, "COLMAP sees other points"
    return model


def evo(reference, other):
    paths = [file_interface.read_tum_trajectory_file(str(path)) for path in (reference, other)]
    for path in paths:
        assert path.check()[0], path.check()[1]
    first, second = sync.associate_trajectories(*paths, max_diff=1e-6)
    second.align(first, correct_scale=False)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((first, second))
    moved = error.get_statistic(metrics.StatisticsType.rmse)
    print(f"evo: {paths[0].num_poses} poses, {paths[1].num_poses} keyframes; moved by {moved:.3f} m RMSE")


def main():
    map_folder = sys.argv[1]
    evermap = sys.argv[3] if len(sys.argv) > 3 else EVERMAP
    session = sys.argv[2] if len(sys.argv) > 2 else "initial"
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        export(evermap, map_folder, "adjusted_poses", "colmap", out / "model")
        colmap(out / "model")
        for layer in ("poses", "keyframes"):
            export(evermap, map_folder, layer, "tum", out / f"{layer}.tum", "--session", session)
        evo(out / "poses.tum", out / "keyframes.tum")


if __name__ == "__main__":
    main()
