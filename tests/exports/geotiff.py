"""Reads a GeoTIFF of two tiles with GDAL's eyes: earth|local|colour FILE. The tiles, -1/0 and 0/1 of 400 cells of 0.5 m, have the
grey (column + 3 row) mod 256; on earth the map's x axis points north. In colour that is red, green the rest to 255, blue 7."""

import sys

import numpy
import rasterio
import rasterio.warp
from rio_cogeo import cog_validate

SIDE, CELL_M = 400, 0.5


def expected():
    row, column = numpy.mgrid[0:SIDE, 0:SIDE]
    tile = (column + 3 * row).astype("uint8")
    grey, alpha = numpy.zeros((2, 2 * SIDE, 2 * SIDE), "uint8")
    for rows, columns in ((slice(SIDE, None), slice(0, SIDE)), (slice(0, SIDE), slice(SIDE, None))):
        grey[rows, columns], alpha[rows, columns] = tile, 255
    return grey, alpha


def main(where, path):
    grey, alpha = expected()
    bands, names, first = [grey], ["gray"], [2]
    if where == "colour":
        seen = alpha > 0
        bands = [grey, numpy.where(seen, 255 - grey, 0), numpy.where(seen, 7, 0)]
        names, first = ["red", "green", "blue"], [2, 253, 7]
    bands, names = [*bands, alpha], [*names, "alpha"]
    sound, errors, warnings = cog_validate(path, strict=True, quiet=True)
    assert sound, (errors, warnings)
    with rasterio.open(path) as file:
        assert (file.width, file.height, file.count) == (2 * SIDE, 2 * SIDE, len(bands))
        assert file.block_shapes == [(256, 256)] * len(bands) and file.compression.name == "deflate"
        assert [one.name for one in file.colorinterp] == names
        assert (file.read() == numpy.stack(bands)).all()
        assert (file.dataset_mask() == alpha).all()
        assert file.overviews(1) == [2, 4]
        # Of the north-western cells of the north-eastern tile, 2 by 2: 0, 1, 3 and 4.
        half = file.read(out_shape=(len(bands), SIDE, SIDE))
        assert half[:, 0, SIDE // 2].tolist() == [*first, 255] and not half[:, 0, 0].any()
        # The corner of the north-eastern tile is 0 m, 400 m in the map; a step to the right is 0.5 m along x.
        corner, right = file.transform * (SIDE, 0), file.transform * (SIDE + 1, 0)
        if where != "earth":
            assert numpy.allclose((*corner, *right), (0, 400, CELL_M, 400), atol=1e-9), (corner, right)
            assert not file.crs.is_projected and not file.crs.is_geographic, file.crs
            assert file.crs.units_factor == ("metre", 1.0), file.crs
            return
        assert numpy.allclose((*corner, *right), (-400, 0, -400, CELL_M), atol=1e-9), (corner, right)
        assert file.crs.is_projected and "evermap site lot" in file.crs.to_wkt(), file.crs
        ((longitude,), (latitude,)) = rasterio.warp.transform(file.crs, "EPSG:4326", [-50.0], [100.0])
        # As the test of `earth.rs` has it of the point 100 m, 50 m of the map.
        assert abs(longitude - 10.49926787) < 1e-7 and abs(latitude - 52.25089868) < 1e-7, (longitude, latitude)


main(*sys.argv[1:])
