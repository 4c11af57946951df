"""Frames or reconstructions as an NWB file (Neurodata Without Borders), by pynwb.

The series is a `OnePhotonSeries` with its imaging plane and device. Where the package ndx-miniscope is installed, the
device is a `Miniscope` of it.
"""

from __future__ import annotations

import os
import tempfile
import uuid
from itertools import chain
from pathlib import Path

import numpy as np

# Intervals that differ by less are one rate: nwbinspector rounds to as many digits.
_SAME_INTERVAL_S = 1e-9


def write(
    path,
    frames,
    *,
    session_start_time,
    timestamps_s=None,
    rate_hz=None,
    instrument=None,
    pixel_um=None,
    name="OnePhotonSeries",
    description="Wide-field frames of a multi-aperture miniscope, reconstructed by Ommatidia",
    unit="a.u.",
    indicator="unknown",
    location="unknown",
    excitation_nm=470.0,
    emission_nm=520.0,
    device=None,
    nwbfile=None,
    subject=None,
    force=False,
):
    """Writes `frames`, [n, rows, cols] or an iterable of [rows, cols], to the NWB file at `path`.

    `timestamps_s` are the times of the frames, s after `session_start_time` (a `datetime` with its time zone); gaps are
    kept, since unequal intervals are written as they are. Equal intervals are written as a rate. Without timestamps
    `rate_hz` is needed. `instrument` gives the side of an object pixel, or `pixel_um` does.

    `device` has further fields of the device (those of ndx-miniscope's `Miniscope`, if that is installed), `nwbfile` of
    the file (`experimenter`, `institution`, ...), `subject` of the subject (`subject_id`, `species`, `sex`, `age`).

    The file appears whole or not at all. One that exists is kept unless `force`. Returns the number of frames.
    """
    try:
        import pynwb
        from hdmf.data_utils import DataChunkIterator
        from pynwb.ophys import OnePhotonSeries, OpticalChannel
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("ommatidia.nwb needs pynwb: `pip install pynwb`", name=error.name) from error
    path = Path(path)
    if path.exists() and not force:
        raise FileExistsError(f"{path}: exists already and is kept; choose another name, or replace it with force=True")
    if session_start_time.tzinfo is None:
        raise ValueError("session_start_time: expected a time with its time zone, found one without")
    first, shape, frames = _first(frames)
    times = _times(timestamps_s, rate_hz)
    if timestamps_s is not None and shape[0] is not None:
        _same_number(timestamps_s, shape[0])
    if pixel_um is None and instrument is not None:
        pixel_um = instrument.manifest["object"]["pixel_um"]

    file = pynwb.NWBFile(
        session_description=description,
        identifier=str(uuid.uuid4()),
        session_start_time=session_start_time,
        **(nwbfile or {}),
    )
    if subject is not None:
        file.subject = pynwb.file.Subject(**subject)
    scope = _device(pynwb, device or {})
    file.add_device(scope)
    grid = {}
    if pixel_um is not None:
        grid = {"grid_spacing": [pixel_um * 1e-6] * 2, "grid_spacing_unit": "meters"}
    rate = {"imaging_rate": times["rate"]} if "rate" in times else {}
    plane = file.create_imaging_plane(
        name="ImagingPlane",
        description="object plane of the instrument",
        optical_channel=OpticalChannel(
            name="OpticalChannel", description="fluorescence", emission_lambda=float(emission_nm)
        ),
        device=scope,
        excitation_lambda=float(excitation_nm),
        indicator=indicator,
        location=location,
        **grid,
        **rate,
    )
    counted = _Counted(frames, first.shape, timestamps_s)
    # About 10 MB at a time, whatever the length of the recording.
    buffer = max(1, 10_000_000 // max(1, first.size * first.itemsize))
    data = DataChunkIterator(
        data=iter(counted), maxshape=(shape[0], *first.shape), dtype=first.dtype, buffer_size=buffer
    )
    series = OnePhotonSeries(
        name=name, description=description, data=data, unit=unit, imaging_plane=plane, **times
    )
    file.add_acquisition(series)
    handle, unfinished = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".unfinished.nwb")
    os.close(handle)
    try:
        with pynwb.NWBHDF5IO(unfinished, "w") as io:
            io.write(file)
        counted.check()
        # Temporary files are private; this one becomes a result.
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(unfinished, 0o666 & ~mask)
        os.replace(unfinished, path)
    except BaseException:
        os.unlink(unfinished)
        raise
    return counted.count


class _Counted:
    """Counts frames as they go by and compares their number with that of the timestamps."""

    def __init__(self, frames, shape, timestamps):
        self.frames, self.shape, self.timestamps, self.count = frames, shape, timestamps, 0

    def __iter__(self):
        for frame in self.frames:
            frame = np.asarray(frame)
            if frame.shape != self.shape:
                raise ValueError(f"frame {self.count}: expected {list(self.shape)}, found {list(frame.shape)}")
            self.count += 1
            yield frame

    def check(self):
        if self.timestamps is not None:
            _same_number(self.timestamps, self.count)


def _same_number(timestamps, count):
    if len(timestamps) != count:
        raise ValueError(f"timestamps_s: expected one a frame, found {len(timestamps)} for {count} frames")


def _first(frames):
    """The first frame, the shape as far as it is known, and all frames again."""
    if hasattr(frames, "shape"):
        if len(frames.shape) != 3 or frames.shape[0] == 0:
            raise ValueError(f"frames: expected [n, rows, cols], found {list(frames.shape)}")
        return np.asarray(frames[0]), frames.shape, frames
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise ValueError("frames: expected one or more, found none")
    first = np.asarray(first)
    if first.ndim != 2:
        raise ValueError(f"frames: expected [rows, cols] each, found {list(first.shape)}")
    return first, (None, *first.shape), chain([first], frames)


def _times(timestamps_s, rate_hz):
    """The fields of a series that say when its frames were taken."""
    if timestamps_s is None:
        if rate_hz is None or not rate_hz > 0:
            raise ValueError("timestamps_s or rate_hz: expected one of them, found neither")
        return {"rate": float(rate_hz), "starting_time": 0.0}
    if rate_hz is not None:
        raise ValueError("timestamps_s and rate_hz: expected one of them, found both; the timestamps say the rate")
    times = np.asarray(timestamps_s, dtype=np.float64)
    if times.ndim != 1 or len(times) == 0 or not np.isfinite(times).all():
        raise ValueError("timestamps_s: expected finite numbers, one a frame")
    intervals = np.diff(times)
    back = np.flatnonzero(intervals <= 0)
    if len(back):
        i = int(back[0]) + 1
        raise ValueError(f"timestamps_s: expected times that rise, found {times[i]} after {times[i - 1]} at frame {i}")
    if len(times) > 2 and np.ptp(intervals) < _SAME_INTERVAL_S:
        return {"rate": float(len(intervals) / (times[-1] - times[0])), "starting_time": float(times[0])}
    return {"timestamps": times}


def _device(pynwb, fields):
    """The miniscope: of ndx-miniscope where that is installed."""
    fields = {"name": "Miniscope", **fields}
    try:
        from ndx_miniscope import Miniscope
    except ModuleNotFoundError:
        return pynwb.device.Device(**{"description": "multi-aperture miniscope", **fields})
    usual = {"deviceType": "multi-aperture miniscope", "compression": "none"}
    return Miniscope(**{**usual, **fields})
