//! Parts of a reconstruction in a folder beside its output, so that it can be stopped, continued, and shared among
//! computers. A part is made where its file is missing or not whole, by whoever has it in their share; the parts are
//! the same whatever the number of shares.

use anyhow::{Context, bail};
use ndarray::Array2;
use ommatidia_model::dataset::Share;
use ommatidia_session::artifact::{file_hash, folder_of, remove_leftovers, state_of_files, write_whole};
use ommatidia_session::{FrameReader, FrameWriter, SampleType, StackSpec, need_file_size, need_space};
use serde_json::{Value, json};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Frames of one part.
const FRAMES: usize = 32;
/// File that says which reconstruction the parts of a folder belong to.
pub const PLAN: &str = "parts.json";

/// The parts of a reconstruction.
pub struct Parts {
    output: PathBuf,
    folder: PathBuf,
    plan: Value,
    frames: usize,
}

impl Parts {
    /// The folder of the parts of an output.
    pub fn folder_of(output: &Path) -> PathBuf {
        let mut name = output.file_name().unwrap_or_default().to_os_string();
        name.push(".parts");
        output.with_file_name(name)
    }

    /// What the parts depend on: the method and its file, and the frames.
    ///
    /// # Errors
    /// A file cannot be read.
    pub fn plan(frames: &mut FrameReader, with: &Path, method: &str, seed: u64) -> anyhow::Result<Value> {
        // The files as they are, and the first and the last frame: a recording of some terabytes is not read twice.
        let mut sums = Vec::new();
        for i in [0, frames.len() - 1] {
            sums.push(frames.read(i)?.iter().map(|v| f64::from(*v)).sum::<f64>());
        }
        let shape = [frames.len(), frames.rows(), frames.cols()];
        let whole = [frames.path().to_path_buf()];
        let files: Vec<PathBuf> = frames.parts().iter().map(|part| part.path.clone()).collect();
        let files = state_of_files(if files.is_empty() { &whole } else { &files })?;
        let file = file_hash(with)?;
        Ok(json!({
            "method": method, "with": file, "seed": seed, "frames": shape, "sums": sums, "files": files, "part": FRAMES
        }))
    }

    /// The parts of an output, of which some may be there. Nothing is written yet.
    ///
    /// # Errors
    /// Its folder holds parts of another reconstruction.
    pub fn open(output: &Path, plan: Value) -> anyhow::Result<Self> {
        let folder = Self::folder_of(output);
        let there = std::fs::read_to_string(folder.join(PLAN));
        if there.is_ok_and(|text| serde_json::from_str::<Value>(&text).ok().as_ref() != Some(&plan)) {
            bail!(
                "{}: holds parts of another reconstruction (other method, network or seed, other frames, or a file of \
                 frames that was changed since); remove the folder, or choose another output",
                folder.display()
            );
        }
        let frames = plan["frames"][0].as_u64().unwrap_or(0) as usize;
        Ok(Self { output: output.into(), folder, plan, frames })
    }

    /// Makes the folder, and notes in it what its parts are of.
    fn begin(&self) -> anyhow::Result<()> {
        std::fs::create_dir_all(&self.folder).with_context(|| self.folder.display().to_string())?;
        let path = self.folder.join(PLAN);
        if !path.is_file() {
            // Several shares may write it at the same time: they write the same.
            write_whole(&path, format!("{}\n", self.plan).as_bytes())?;
        }
        Ok(())
    }

    /// Number of parts.
    pub fn count(&self) -> usize {
        self.frames.div_ceil(FRAMES)
    }

    /// The parts of a share that are missing or not whole, and their frames.
    pub fn missing(&self, share: Share) -> Vec<(usize, Range<usize>)> {
        let of = |k: usize| (k, k * FRAMES..((k + 1) * FRAMES).min(self.frames));
        (0..self.count()).filter(|k| share.holds(*k)).map(of).filter(|(k, r)| !self.is_whole(*k, r)).collect()
    }

    fn is_whole(&self, k: usize, frames: &Range<usize>) -> bool {
        let there = || FrameReader::open(&self.path(k)).is_ok_and(|reader| reader.len() == frames.len());
        // Noted when the part was made: a part may have been damaged since.
        let noted = std::fs::read_to_string(self.sum_path(k));
        there() && noted.is_ok_and(|noted| file_hash(&self.path(k)).is_ok_and(|found| noted.trim() == found))
    }

    /// The file with the SHA-256 of a part.
    fn sum_path(&self, k: usize) -> PathBuf {
        self.path(k).with_extension("npy.sha256")
    }

    fn path(&self, k: usize) -> PathBuf {
        self.folder.join(format!("part-{k:06}.npy"))
    }

    /// Makes one part. `object` gives the object of a frame. `ahead` frames, with those of this part, are still to be
    /// written into the folder or beside it.
    ///
    /// # Errors
    /// A frame cannot be reconstructed, the folder is not writable, or its disk has no room for what is ahead.
    pub fn make(
        &self,
        k: usize,
        frames: Range<usize>,
        ahead: usize,
        mut object: impl FnMut(usize) -> anyhow::Result<Array2<f32>>,
    ) -> anyhow::Result<()> {
        let path = self.path(k);
        // A part belongs to one share, so what is left of it belongs to a run that was killed.
        remove_leftovers(&path);
        let mut writer: Option<FrameWriter> = None;
        for i in frames.clone() {
            let object = object(i)?;
            let writer = match &mut writer {
                Some(writer) => writer,
                None => {
                    let (rows, cols) = object.dim();
                    let spec = StackSpec { frames: frames.len(), rows, cols, samples: SampleType::F32, pixel_um: None };
                    let of_frame = spec.bytes() / frames.len() as u64;
                    need_space(folder_of(&self.folder), &self.folder, ahead as u64 * of_frame)?;
                    // A .zarr is many files.
                    if !self.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("zarr")) {
                        need_file_size(&self.output, self.frames as u64 * of_frame)?;
                    }
                    self.begin()?;
                    writer.insert(FrameWriter::create(&path, spec)?)
                }
            };
            writer.push(object.view())?;
        }
        writer.map_or(Ok(()), FrameWriter::finish)?;
        write_whole(&self.sum_path(k), format!("{}\n", file_hash(&path)?).as_bytes())?;
        Ok(())
    }

    /// Gives all objects in the order of the frames. All parts must be there.
    ///
    /// # Errors
    /// A part cannot be read, or `take` fails.
    pub fn each(&self, mut take: impl FnMut(Array2<f32>) -> anyhow::Result<()>) -> anyhow::Result<()> {
        for k in 0..self.count() {
            let mut reader = FrameReader::open(&self.path(k))?;
            for i in 0..reader.len() {
                take(reader.read(i)?)?;
            }
        }
        Ok(())
    }

    /// Removes the parts, after the output is written.
    pub fn remove(self) {
        // What stays costs room only.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
