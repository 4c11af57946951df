//! A stack that lies in chunks of [frames, rows, cols]: which chunks a frame is made of, and those that are held.

use super::codec::damaged;
use super::number::Number;
use std::io::Result;

/// Largest frame and largest chunk that are read, bytes. A hostile file may not take more memory than some of these.
const MAX_BYTES: usize = 1 << 29;
/// Most chunks that one frame is made of.
const MOST_PER_FRAME: usize = 1 << 16;
/// Frames of one row of chunks are held up to so many bytes together, so that a chunk is read once for several frames.
const HELD_BYTES: usize = 1 << 28;

/// The chunks of a stack, and the frames that are held.
#[derive(Debug)]
pub(super) struct Chunks {
    shape: [usize; 3],
    chunk: [usize; 3],
    number: Number,
    /// First frame that is held, and the bytes of all.
    first: usize,
    held: Vec<u8>,
}

impl Chunks {
    /// Chunks of a stack [frames, rows, cols]; those at its end are as large as the others.
    pub fn new(shape: [usize; 3], chunk: [usize; 3], number: Number) -> Result<Self> {
        let bytes = |axes: &[usize]| axes.iter().try_fold(number.bytes(), |n, axis| n.checked_mul(*axis));
        let fits = |axes: &[usize]| bytes(axes).is_some_and(|n| n <= MAX_BYTES);
        if chunk.contains(&0) || !fits(&chunk) || !fits(&shape[1..]) {
            return Err(damaged(format!(
                "chunks of {chunk:?}, of an array {shape:?}: frames and chunks of 1 to {MAX_BYTES} bytes are read"
            )));
        }
        let chunks = Self { shape, chunk, number, first: 0, held: Vec::new() };
        let [_, down, across] = chunks.grid();
        if down.saturating_mul(across) > MOST_PER_FRAME {
            return Err(damaged(format!("{down} x {across} chunks a frame; at most {MOST_PER_FRAME} are read")));
        }
        Ok(chunks)
    }

    /// Bytes of a chunk.
    pub fn chunk_bytes(&self) -> usize {
        self.chunk.iter().product::<usize>() * self.number.bytes()
    }

    /// Number of chunks along each axis.
    pub fn grid(&self) -> [usize; 3] {
        std::array::from_fn(|axis| self.shape[axis].div_ceil(self.chunk[axis]))
    }

    /// The bytes of frame `i`. `fetch` reads a chunk by its place in the grid; `None` stands for one of nothing but the
    /// number `fill`.
    pub fn frame(
        &mut self,
        i: usize,
        fill: &[u8],
        mut fetch: impl FnMut([usize; 3]) -> Result<Option<Vec<u8>>>,
    ) -> Result<&[u8]> {
        let bytes = self.shape[1] * self.shape[2] * self.number.bytes();
        let is_held = i >= self.first && i - self.first < self.held.len() / bytes.max(1);
        if !is_held {
            self.held.clear();
            let [_, down, across] = self.grid();
            let slab = i / self.chunk[0];
            let (start, end) = (slab * self.chunk[0], self.shape[0].min((slab + 1).saturating_mul(self.chunk[0])));
            let most = (HELD_BYTES / bytes.max(1)).max(1);
            // All frames of the chunks, or as many from this one on as may be held.
            self.first = if end - start <= most { start } else { i };
            let frames = self.first..end.min(self.first + most);
            let mut held = vec![0; frames.len() * bytes];
            if fill.iter().any(|b| *b != 0) {
                held.chunks_exact_mut(fill.len()).for_each(|number| number.copy_from_slice(fill));
            }
            for at in (0..down).flat_map(|r| (0..across).map(move |c| [slab, r, c])) {
                if let Some(chunk) = fetch(at)? {
                    if chunk.len() != self.chunk_bytes() {
                        let detail = format!("chunk {at:?} has {} bytes, not {}", chunk.len(), self.chunk_bytes());
                        return Err(damaged(detail));
                    }
                    self.place(&mut held, frames.clone(), at, &chunk);
                }
            }
            self.held = held;
        }
        let from = (i - self.first) * bytes;
        Ok(&self.held[from..from + bytes])
    }

    /// Copies the rows of a chunk that belong to the frames.
    fn place(&self, held: &mut [u8], frames: std::ops::Range<usize>, at: [usize; 3], chunk: &[u8]) {
        let (size, [_, rows, cols], [deep, high, wide]) = (self.number.bytes(), self.shape, self.chunk);
        let [start, top, left] = [at[0] * deep, at[1] * high, at[2] * wide];
        let width = wide.min(cols - left) * size;
        for frame in frames.clone() {
            for row in top..rows.min(top + high) {
                let from = ((frame - start) * high + row - top) * wide * size;
                let to = (((frame - frames.start) * rows + row) * cols + left) * size;
                held[to..to + width].copy_from_slice(&chunk[from..from + width]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn frames_are_put_together_from_chunks_that_are_read_once() {
        let shape = [5, 7, 6];
        let chunk = [2, 3, 4];
        let value = |f: usize, r: usize, c: usize| (100 * f + 10 * r + c) as u16;
        let mut chunks = Chunks::new(shape, chunk, Number::U16).unwrap();
        assert_eq!((chunks.grid(), chunks.chunk_bytes()), ([3, 3, 2], 48));
        let mut fetched = Vec::new();
        for i in [0, 1, 4, 2, 3] {
            let fetch = |at: [usize; 3]| {
                fetched.push(at);
                if at == [1, 0, 0] {
                    return Ok(None);
                }
                let axis = |a: usize| at[a] * chunk[a]..(at[a] + 1) * chunk[a];
                let numbers = axis(0).flat_map(|f| axis(1).map(move |r| (f, r)));
                Ok(Some(numbers.flat_map(|(f, r)| axis(2).flat_map(move |c| value(f, r, c).to_le_bytes())).collect()))
            };
            let frame = chunks.frame(i, &7u16.to_le_bytes(), fetch).unwrap();
            let expected = (0..7).flat_map(|r| (0..6).map(move |c| (r, c))).flat_map(|(r, c)| {
                let missing = (2..4).contains(&i) && r < 3 && c < 4;
                if missing { 7 } else { value(i, r, c) }.to_le_bytes()
            });
            assert_eq!(frame, expected.collect::<Vec<u8>>(), "frame {i}");
        }
        assert_eq!(fetched.len(), 18);
        let short = chunks.frame(0, &[0, 0], |_| Ok(Some(vec![0; 47])));
        assert!(short.unwrap_err().to_string().contains("47 bytes, not 48"));
    }

    #[test]
    fn sizes_that_no_sensor_has_are_refused() {
        for chunk in [[0, 1, 1], [1 << 20, 1 << 10, 1], [usize::MAX, 2, 2]] {
            assert!(Chunks::new([4, 4, 4], chunk, Number::U16).is_err(), "{chunk:?}");
        }
        assert!(Chunks::new([1, 1 << 15, 1 << 15], [1, 1, 1], Number::U16).is_err());
    }
}
