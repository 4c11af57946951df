#!/usr/bin/env python3
"""Writes the recordings in host/session/tests/recordings with the writers that laboratories use.

Frame f, row r, column c holds 1000 f + 37 r + c, of 5 frames of 24 x 32 pixels (numbers of 8 bits: modulo 251).
Needs numpy, scipy, h5py, hdf5storage, zarr, numcodecs and ome-zarr:

    python3 tests/formats/write.py host/session/tests/recordings
"""
import pathlib
import shutil
import sys

import h5py
import hdf5storage
import numcodecs
import numpy as np
import ome_zarr.format
import ome_zarr.writer
import scipy.io
import zarr

FRAMES, ROWS, COLS = 5, 24, 32
f, r, c = np.meshgrid(np.arange(FRAMES), np.arange(ROWS), np.arange(COLS), indexing="ij")
stack = (1000 * f + 37 * r + c).astype("uint16")
bytes_ = (stack % 251).astype("uint8")
# MATLAB's order: rows, columns, frames.
movie = np.ascontiguousarray(stack.transpose(1, 2, 0))
extra = {"fs": 20.0, "note": "a text", "s": {"a": np.arange(3)}}


def level5(folder):
    scipy.io.savemat(folder / "level5.mat", {**extra, "Y": movie})
    several = {"Y": movie.astype("float64"), "dark": bytes_[:2].transpose(1, 2, 0), **extra}
    scipy.io.savemat(folder / "level5-compressed.mat", several, do_compression=True)


def version_73(folder):
    file = str(folder / "v73.mat")
    # In chunks, shuffled, deflated and with checksums.
    options = hdf5storage.Options(store_python_metadata=False, make_atleast_2d=True, compress_size_threshold=0)
    for name, value in {"s": {"a": np.arange(3)}, "Y": movie}.items():
        hdf5storage.write(value, path=f"/{name}", filename=file, options=options)
    # In one piece, as MATLAB writes small arrays.
    with h5py.File(folder / "v73-h5py.mat", "w", userblock_size=512) as file:
        file["Y"] = bytes_.transpose(0, 2, 1)
        file["fs"] = np.array([[20.0]])
        # As MATLAB writes larger ones; in small chunks.
        chunks = dict(chunks=(2, 16, 5), compression="gzip", compression_opts=3)
        file.create_dataset("Z", data=movie.T, **chunks)
        file["later"] = bytes_[:1].transpose(0, 2, 1)
    with open(folder / "v73-h5py.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, written by h5py".ljust(124) + b"\x00\x02IM")


def images(folder):
    versions = [("image-0.4.zarr", ome_zarr.format.FormatV04()), ("image-0.5.zarr", ome_zarr.format.FormatV05())]
    for name, version in versions:
        group = zarr.open_group(folder / name, mode="w", zarr_format=version.zarr_format)
        ome_zarr.writer.write_image(
            stack[:, None, None], group, scale_factors=[2], fmt=version, axes="tczyx",
            scale={"t": 0.05, "y": 2.0, "x": 2.5},
            axes_units={"t": "second", "y": "micrometer", "x": "micrometer"},
            storage_options={"chunks": (2, 1, 1, 16, 32)},
        )


def arrays(folder):
    """Plain arrays, one for each way of compressing chunks."""
    blosc = [("lz4", 1), ("lz4hc", 2), ("zstd", 0), ("zstd", 2), ("zlib", 1)]
    compressors = {f"blosc-{name}-{shuffle}": numcodecs.Blosc(cname=name, shuffle=shuffle) for name, shuffle in blosc}
    compressors |= {"zlib": numcodecs.Zlib(), "gzip": numcodecs.GZip(), "zstd": numcodecs.Zstd()}
    compressors |= {"lz4": numcodecs.LZ4()}
    compressors |= {"plain": None}
    for name, compressor in compressors.items():
        new = dict(shape=stack.shape, chunks=(5, 24, 32), compressors=compressor, zarr_format=2)
        zarr.create_array(folder / f"{name}.zarr", dtype="uint16", **new)[:] = stack
    new = dict(shape=stack.shape, chunks=(5, 24, 32), dtype=">f4", compressors=None, zarr_format=2)
    zarr.create_array(folder / "big-endian.zarr", **new)[:] = stack
    # Several chunks in a file, and some that are nothing but the fill value and not there.
    sharded = zarr.create_array(
        folder / "sharded.zarr", shape=stack.shape, chunks=(1, 12, 16), shards=(4, 24, 32), dtype="uint16",
        fill_value=7, config={"write_empty_chunks": False},
    )
    holes = stack.copy()
    holes[4] = 7
    holes[2, :12, :16] = 7
    sharded[:] = holes
    new = dict(shape=stack.shape, chunks=(2, 24, 32), dtype="uint8", zarr_format=3)
    codec = zarr.codecs.BloscCodec(cname="zstd", shuffle="bitshuffle", typesize=1)
    zarr.create_array(folder / "blosc-3.zarr", compressors=codec, **new)[:] = bytes_


if __name__ == "__main__":
    folder = pathlib.Path(sys.argv[1])
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for write in (level5, version_73, images, arrays):
        write(folder)
    # Two files that MATLAB wrote: they come with scipy's tests.
    theirs = pathlib.Path(scipy.io.__file__).parent / "matlab/tests/data"
    for name in ("test3dmatrix_6.1_SOL2", "test3dmatrix_7.4_GLNX86", "testhdf5_7.4_GLNX86"):
        shutil.copyfile(theirs / f"{name}.mat", folder / f"matlab-{name}.mat")
