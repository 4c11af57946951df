//! The fuzz targets without libFuzzer, for builds in which it cannot be linked: a 32-bit program, in which lengths wrap
//! as they do on a microcontroller. Inputs are the seeds, what longer runs have found (`target/fuzz/corpus`, where
//! `OMMATIDIA_CORPUS` names it), and mutations of both for `OMMATIDIA_SECONDS` each (5 by default).

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Lengths that are likely at a boundary.
const NUMBERS: [u8; 10] = [0, 1, 2, 0x7e, 0x7f, 0x80, 0x81, 0xfe, 0xff, 0x40];

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % n.max(1) as u64) as usize
    }

    /// A few changes near each other: bytes replaced, flipped, inserted, removed, or copied from another input.
    fn mutate(&mut self, input: &mut Vec<u8>, other: &[u8]) {
        // Half of the changes are in the header of a network file.
        let window = if self.below(2) == 0 { 128 } else { input.len() };
        for _ in 0..=self.below(6) {
            let at = self.below(window.min(input.len()));
            match self.below(6) {
                _ if input.is_empty() => input.push(self.below(256) as u8),
                0 => input[at] ^= 1 << self.below(8),
                1 => input[at] = NUMBERS[self.below(NUMBERS.len())],
                2 => input[at] = self.below(256) as u8,
                3 => input.insert(at, self.below(256) as u8),
                4 => drop(input.remove(at)),
                _ => {
                    let len = self.below(32).min(other.len()).min(input.len() - at);
                    let from = self.below(other.len() - len + 1);
                    input[at..at + len].copy_from_slice(&other[from..from + len]);
                }
            }
        }
    }
}

fn inputs(name: &str) -> Vec<Vec<u8>> {
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("seeds").join(name)];
    folders.extend(std::env::var_os("OMMATIDIA_CORPUS").map(|corpus| PathBuf::from(corpus).join(name)));
    let files = folders.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten();
    files.map(|file| std::fs::read(file.expect("a folder that can be read").path()).expect("a file")).collect()
}

fn run(name: &str, try_input: fn(&[u8])) {
    let inputs = inputs(name);
    assert!(inputs.len() > 1, "no seeds for {name}");
    inputs.iter().for_each(|input| try_input(input));
    let seconds = std::env::var("OMMATIDIA_SECONDS").ok().and_then(|s| s.parse().ok()).unwrap_or(5);
    let (began, mut random, mut tried) = (Instant::now(), Random(19), 0_u64);
    while began.elapsed() < Duration::from_secs(seconds) {
        let mut input = inputs[random.below(inputs.len())].clone();
        let other = random.below(inputs.len());
        random.mutate(&mut input, &inputs[other]);
        let bytes = input.clone();
        if std::panic::catch_unwind(|| try_input(&bytes)).is_err() {
            let path = std::env::temp_dir().join(format!("ommatidia-{name}-{tried}"));
            std::fs::write(&path, &input).expect("room for the finding");
            panic!("input {tried} of {name} breaks its claim; it is kept in {}", path.display());
        }
        tried += 1;
    }
    println!("{name}: {} inputs and {tried} mutations, {} bits", inputs.len(), usize::BITS);
}

#[test]
fn network_files() {
    run("blob", ommatidia_fuzz::blob::try_input);
}

#[test]
fn messages() {
    run("wire", ommatidia_fuzz::wire::try_input);
}

#[test]
fn devices() {
    run("device", ommatidia_fuzz::device::try_input);
}

#[test]
fn sessions() {
    run("session", ommatidia_fuzz::session::try_input);
}

#[test]
fn recordings() {
    run("recording", ommatidia_fuzz::recording::try_input);
}
