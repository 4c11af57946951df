//! Arbitrary bytes as a .mat file, or as one file of a sound Zarr: the recording is refused in words, or its frames are
//! read.

use ommatidia_session::FrameReader;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Where an input goes. The files of one Zarr lie in one folder.
const FILES: [&str; 6] =
    ["x.mat", "image/.zattrs", "image/0/.zarray", "image/0/0.0.0.0.0", "plain/zarr.json", "plain/c/0/0/0"];
const SOUND: [&str; 6] = ["", IMAGE, ARRAY_2, "0123456789ab", ARRAY_3, "0123456789ab0123456789ab"];

const IMAGE: &str = r#"{"multiscales": [{"version": "0.4", "axes": [
    {"name": "t", "type": "time", "unit": "second"}, {"name": "c"}, {"name": "z"},
    {"name": "y", "unit": "micrometer"}, {"name": "x", "unit": "micrometer"}],
    "datasets": [{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [0.05, 1, 1, 2, 2]}]}]}]}"#;
const ARRAY_2: &str = r#"{"zarr_format": 2, "shape": [3, 1, 1, 3, 2], "chunks": [2, 1, 1, 3, 2], "dtype": "|u1",
    "compressor": {"id": "blosc", "cname": "lz4"}, "fill_value": 7, "order": "C", "filters": null}"#;
const ARRAY_3: &str = r#"{"zarr_format": 3, "node_type": "array", "shape": [3, 3, 2], "data_type": "uint16",
    "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [2, 4, 2]}},
    "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}}, "fill_value": 0,
    "codecs": [{"name": "sharding_indexed", "configuration": {"chunk_shape": [1, 2, 2],
    "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "zstd", "configuration": {}}],
    "index_codecs": [{"name": "bytes", "configuration": {"endian": "little"}}], "index_location": "start"}}]}"#;

/// A folder with all files.
static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let base = Path::new("/dev/shm").is_dir().then(|| "/dev/shm".into()).unwrap_or_else(std::env::temp_dir);
    let folder = tempfile::tempdir_in(base).expect("a folder").keep();
    for (file, sound) in FILES.iter().zip(SOUND) {
        let path = folder.join(file);
        std::fs::create_dir_all(path.parent().expect("a parent")).expect("room");
        std::fs::write(path, sound).expect("room");
    }
    folder
});

/// Tries one input. Panics where the module's claim does not hold.
pub fn try_input(data: &[u8]) {
    let Some((which, hostile)) = data.split_first() else { return };
    let which = usize::from(*which) % FILES.len();
    std::fs::write(FOLDER.join(FILES[which]), hostile).expect("room");
    let recording = FOLDER.join(FILES[which].split('/').next().expect("a name"));
    read(&recording, None);
    if which == 0 {
        read(&recording, Some("Y"));
    }
    std::fs::write(FOLDER.join(FILES[which]), SOUND[which]).expect("room");
}

/// Reads the first frames. Those of a Zarr without its chunks may be large.
fn read(path: &Path, variable: Option<&str>) {
    let Ok(mut frames) = FrameReader::open_variable(path, variable) else { return };
    if frames.rows().saturating_mul(frames.cols()) < 1 << 16 {
        for i in [2, 0, 1].into_iter().filter(|i| *i < frames.len().min(4)).collect::<Vec<_>>() {
            if let Ok(frame) = frames.read(i) {
                assert_eq!(frame.dim(), (frames.rows(), frames.cols()));
            }
        }
    }
}
