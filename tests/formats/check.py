"""Opens what `ommatidia reconstruct` writes with the readers that others use, and compares the values.

Usage: python check.py FOLDER, where FOLDER holds the same reconstruction as x.npy, x.tif, x.zarr (and x.avi).
Needs numpy and, for each format, its reader: tifffile, zarr, ome-zarr, imageio with ffmpeg. A reader that is absent is
named as skipped. Exit code 1 where a value differs.
"""

import importlib.metadata
import pathlib
import sys

import numpy as np

folder = pathlib.Path(sys.argv[1])
truth = np.load(folder / "x.npy")
failed = 0


def check(name, package, judge):
    """Runs one comparison; a missing package is a skip, and is named."""
    global failed
    try:
        version = importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        print(f"skipped  {name}: {package} is not installed")
        return
    try:
        judge()
        print(f"ok       {name}: {package} {version}")
    except Exception as error:
        failed += 1
        print(f"FAILED   {name}: {package} {version}: {type(error).__name__}: {error}")


def tif():
    import tifffile

    with tifffile.TiffFile(folder / "x.tif") as file:
        assert file.is_ome, "not an OME-TIFF"
        series = file.series[0]
        assert series.axes == "TYX", series.axes
        assert np.array_equal(series.asarray(), truth)


def zarr_arrays():
    import zarr

    group = zarr.open_group(folder / "x.zarr", mode="r")
    assert np.array_equal(group["0"][:, 0], truth)
    levels = group.attrs["ome"]["multiscales"][0]["datasets"]
    for coarse in levels[1:]:
        mean = group[coarse["path"]][:, 0].mean()
        assert abs(mean / truth.mean() - 1) < 0.1, (coarse["path"], mean)
    print(f"         {len(levels)} resolutions, chunks {group['0'].chunks}")


def ome_zarr():
    from ome_zarr.io import parse_url
    from ome_zarr.reader import Reader

    nodes = list(Reader(parse_url(folder / "x.zarr"))())
    image = nodes[0]
    axes = [(axis["name"], axis.get("unit")) for axis in image.metadata["axes"]]
    assert [name for name, _ in axes] == ["t", "c", "y", "x"], axes
    assert np.array_equal(np.asarray(image.data[0])[:, 0], truth)
    print(f"         axes {axes}")


check("OME-TIFF", "tifffile", tif)
check("Zarr 3 arrays", "zarr", zarr_arrays)
check("OME-Zarr 0.5", "ome-zarr", ome_zarr)
sys.exit(failed > 0)
