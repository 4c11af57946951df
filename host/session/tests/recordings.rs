//! Recordings of other programs, as `tests/formats/write.py` makes them with the writers that laboratories use: every
//! value of every file.
#![allow(clippy::unwrap_used)]

use ndarray::Array2;
use ommatidia_session::{FrameReader, SampleType};
use std::path::{Path, PathBuf};

const SHAPE: (usize, usize, usize) = (5, 24, 32);

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings").join(name)
}

/// Frame `f` of all files.
fn frame(f: usize) -> Array2<f32> {
    Array2::from_shape_fn((SHAPE.1, SHAPE.2), |(r, c)| (1000 * f + 37 * r + c) as f32)
}

fn expect(name: &str, variable: Option<&str>, samples: SampleType, value: impl Fn(usize) -> Array2<f32>) {
    let mut frames = FrameReader::open_variable(&path(name), variable).unwrap_or_else(|e| panic!("{name}: {e}"));
    assert_eq!((frames.len(), frames.rows(), frames.cols()), SHAPE, "{name}");
    assert_eq!(frames.samples(), samples, "{name}");
    // Not in order: a compressed file is read from its start again.
    for f in [3, 0, 1, 4, 2, 2] {
        assert_eq!(frames.read(f).unwrap_or_else(|e| panic!("{name}: {e}")), value(f), "{name}, frame {f}");
    }
}

#[test]
fn mat_files_of_scipy_hdf5storage_and_h5py() {
    expect("level5.mat", None, SampleType::U16, frame);
    expect("level5-compressed.mat", Some("Y"), SampleType::F32, frame);
    expect("v73.mat", None, SampleType::U16, frame);
    expect("v73-h5py.mat", Some("Y"), SampleType::U8, |f| frame(f).mapv(|v| v % 251.0));
    expect("v73-h5py.mat", Some("Z"), SampleType::U16, frame);
    for (name, listed) in [
        ("level5-compressed.mat", "Y (24 x 32 x 5, double), dark (24 x 32 x 2, uint8), fs (1 x 1, double)"),
        (
            "v73-h5py.mat",
            "Y (24 x 32 x 5, uint8), Z (24 x 32 x 5, uint16), fs (1 x 1, double), later (24 x 32 x 1, uint8)",
        ),
    ] {
        let error = FrameReader::open(&path(name)).unwrap_err().to_string();
        assert!(error.contains(listed) && error.contains("--variable NAME"), "{error}");
    }
    let mut one = FrameReader::open_variable(&path("v73-h5py.mat"), Some("later")).unwrap();
    assert_eq!((one.len(), one.read(0).unwrap()), (1, frame(0).mapv(|v| v % 251.0)));
    for (name, text) in [("s", "struct"), ("note", "char"), ("none", "variable `none`")] {
        let error = FrameReader::open_variable(&path("level5.mat"), Some(name)).unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
    }
}

/// h5py: `f.create_dataset('Y', shape=(5, 32, 24), chunks=(2, 32, 24), dtype='u2', fillvalue=7)`, of which the frames 2
/// and 3 were written; `N` of the same size in one piece, never written; and `L`, a soft link to nothing.
#[test]
fn what_was_never_written_has_the_fill_value_or_is_an_error() {
    let written = |f: usize| if (2..4).contains(&f) { frame(f) } else { Array2::from_elem((SHAPE.1, SHAPE.2), 7.0) };
    expect("unwritten-h5py.mat", Some("Y"), SampleType::U16, written);
    let error = FrameReader::open_variable(&path("unwritten-h5py.mat"), Some("N")).unwrap_err().to_string();
    assert!(error.contains("nothing was written into it") && error.contains("--variable NAME"), "{error}");
    let error = FrameReader::open(&path("unwritten-h5py.mat")).unwrap_err().to_string();
    assert!(error.contains("found N (24 x 32 x 5, uint16), Y (24 x 32 x 5, uint16);"), "{error}");
}

#[test]
fn mat_files_of_matlab() {
    // Of MATLAB 6.1 on a big-endian machine, and of 7.4, compressed: numbers 1 to 24 in MATLAB's order, (2, 3, 4).
    for name in ["matlab-test3dmatrix_6.1_SOL2.mat", "matlab-test3dmatrix_7.4_GLNX86.mat"] {
        let mut frames = FrameReader::open(&path(name)).unwrap();
        assert_eq!((frames.len(), frames.rows(), frames.cols()), (4, 2, 3), "{name}");
        for f in 0..4 {
            let value = |(r, c): (usize, usize)| (1 + r + 2 * c + 6 * f) as f32;
            assert_eq!(frames.read(f).unwrap(), Array2::from_shape_fn((2, 3), value), "{name}");
        }
    }
    // A matrix in one of version 7.3: (1, 9), from 0 to two pi. A matrix is a frame where it is named.
    let name = path("matlab-testhdf5_7.4_GLNX86.mat");
    let mut frames = FrameReader::open_variable(&name, Some("testdouble")).unwrap();
    assert_eq!((frames.len(), frames.rows(), frames.cols()), (1, 1, 9));
    let values = Array2::from_shape_fn((1, 9), |(_, c)| (c as f64 * std::f64::consts::FRAC_PI_4) as f32);
    assert_eq!(frames.read(0).unwrap(), values);
    let error = FrameReader::open(&name).unwrap_err().to_string();
    assert!(error.contains("testdouble (1 x 9, double)"), "{error}");
}

#[test]
fn ome_zarr_of_both_versions() {
    for name in ["image-0.4.zarr", "image-0.5.zarr"] {
        expect(name, None, SampleType::U16, frame);
        let scale = FrameReader::open(&path(name)).unwrap().scale();
        assert_eq!((scale.pixel_um, scale.interval_s), (Some([2.0, 2.5]), Some(0.05)), "{name}");
    }
}

#[test]
fn arrays_of_zarr_with_each_codec() {
    let blosc = ["blosc-lz4-1", "blosc-lz4hc-2", "blosc-zstd-0", "blosc-zstd-2", "blosc-zlib-1"];
    for name in blosc.iter().chain(&["zlib", "gzip", "zstd", "lz4", "plain"]) {
        expect(&format!("{name}.zarr"), None, SampleType::U16, frame);
    }
    expect("big-endian.zarr", None, SampleType::F32, frame);
    expect("blosc-3.zarr", None, SampleType::U8, |f| frame(f).mapv(|v| v % 251.0));
    expect("sharded.zarr", None, SampleType::U16, |f| {
        let mut values = frame(f);
        if f == 4 {
            values.fill(7.0);
        }
        if f == 2 {
            values.slice_mut(ndarray::s![..12, ..16]).fill(7.0);
        }
        values
    });
    let error = FrameReader::open_variable(&path("plain.zarr"), Some("Y")).unwrap_err().to_string();
    assert!(error.contains("only .mat files"), "{error}");
}

/// The frames of a file, read to the last one, as far as they can be; the number that could be read, or the error.
fn read_all(path: &Path) -> Result<usize, String> {
    let variable = path.extension().filter(|suffix| *suffix == "mat").map(|_| "Y");
    let mut frames = FrameReader::open_variable(path, variable).map_err(|e| e.to_string())?;
    (0..frames.len()).try_for_each(|i| frames.read(i).map(drop)).map_err(|e| e.to_string())?;
    Ok(frames.len())
}

#[test]
fn a_file_that_was_cut_short_is_refused_wherever_it_ends() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["level5.mat", "level5-compressed.mat", "v73.mat", "v73-h5py.mat"] {
        let bytes = std::fs::read(path(name)).unwrap();
        let cut = folder.path().join("x.mat");
        for end in (0..bytes.len()).step_by(61).chain([bytes.len() - 1]) {
            std::fs::write(&cut, &bytes[..end]).unwrap();
            match read_all(&cut) {
                Err(text) => assert!(text.contains("x.mat"), "{name}: {text}"),
                Ok(frames) => panic!("{name}, cut at {end}: {frames} frames"),
            }
        }
    }
    for (name, chunk) in [("sharded.zarr", "c/0/0/0"), ("blosc-zstd-2.zarr", "0.0.0"), ("lz4.zarr", "0.0.0")] {
        copy(&path(name), &folder.path().join(name));
        let file = folder.path().join(name).join(chunk);
        let bytes = std::fs::read(&file).unwrap();
        for end in (0..bytes.len()).step_by(61) {
            std::fs::write(&file, &bytes[..end]).unwrap();
            assert!(read_all(&folder.path().join(name)).is_err(), "{name}, cut at {end}");
        }
    }
}

#[test]
fn damaged_bytes_give_an_error_or_frames_and_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["level5.mat", "level5-compressed.mat", "v73.mat", "v73-h5py.mat", "matlab-test3dmatrix_6.1_SOL2.mat"];
    let file = folder.path().join("x.mat");
    let mut refused = 0;
    for name in names {
        let bytes = std::fs::read(path(name)).unwrap();
        // The headers lie at the start; in HDF5 also behind the numbers.
        for at in (0..bytes.len()).filter(|at| at % 31 == 0 || *at < 300) {
            let mut damaged = bytes.clone();
            damaged[at] ^= [1, 0x80, 0xff][at % 3];
            std::fs::write(&file, damaged).unwrap();
            refused += usize::from(read_all(&file).is_err());
        }
    }
    // A changed number is no error, a changed length is.
    assert!(refused > 300, "{refused}");
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap().path();
        let to = to.join(entry.file_name().unwrap());
        if entry.is_dir() { copy(&entry, &to) } else { std::fs::copy(&entry, to).map(drop).unwrap() }
    }
}
