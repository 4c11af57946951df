//! The table of instructions in `docs/instructions.md`: written, read back, and compared with new counts.

use super::count::{BoardCounts, OperatorCount};
use super::error::DeviceError;
use super::footprint::Footprint;
use super::rates;
use ommatidia_shared::boards::{BOARDS, Board};

/// Relative growth of a count that the check accepts; compilers differ a little outside the loops.
const TOLERANCE: f64 = 0.02;

/// A library's count of an operator: instructions per unit of its work, and whose.
type Peer = (&'static str, f64, &'static str);

/// Instructions of C libraries for the same work, counted under QEMU 7.2 with the better of gcc 12 (-O3, -Ofast) and
/// clang 19; those in integers by `tests/cmsis_nn/count.py` with gcc 12.
const PEERS: [(&str, &[Peer]); 3] = [
    (
        "mps2-an500",
        &[
            ("2-D real FFT 64x64, forward", 242_856.0 / 4096.0, "microfft, f32"),
            ("2-D real FFT 64x64, filter, inverse", 574_135.0 / 4096.0, "CMSIS-DSP, f32"),
            ("2-D real FFT 128x128, filter, inverse", 2_399_654.0 / 16384.0, "CMSIS-DSP, f32"),
            ("3x3 convolution 32->32, 48x48", 1.48, "best C"),
            (SMALL, 12_382_374.0 / SMALL_WORK, S8),
            (SMALL_BYTES, 12_382_374.0 / SMALL_WORK, S8),
            (SMALL, 12_656_460.0 / SMALL_WORK, S16),
            (LARGE, 40_908_785.0 / LARGE_WORK, S8),
            (LARGE_BYTES, 40_908_785.0 / LARGE_WORK, S8),
            (LARGE, 43_368_779.0 / LARGE_WORK, S16),
        ],
    ),
    (
        "mps3-an547",
        &[
            ("2-D real FFT 64x64, forward", 105_666.0 / 4096.0, "CMSIS-DSP, f32"),
            ("2-D real FFT 64x64, forward", 76_188.0 / 4096.0, "CMSIS-DSP, f16"),
            ("2-D real FFT 64x64, filter, inverse", 200_386.0 / 4096.0, "CMSIS-DSP, f32"),
            ("2-D real FFT 64x64, filter, inverse", 150_256.0 / 4096.0, "CMSIS-DSP, f16"),
            ("2-D real FFT 128x128, filter, inverse", 765_186.0 / 16384.0, "CMSIS-DSP, f32"),
            ("2-D real FFT 128x128, filter, inverse", 515_760.0 / 16384.0, "CMSIS-DSP, f16"),
            ("3x3 convolution 32->32, 48x48", 0.69, "CMSIS-NN, f32"),
            ("3x3 convolution 32->32, 48x48", 0.36, "CMSIS-NN, sums in f16"),
            (SMALL, 2_058_550.0 / SMALL_WORK, S8),
            (SMALL_BYTES, 2_058_550.0 / SMALL_WORK, S8),
            (SMALL, 2_896_909.0 / SMALL_WORK, S16),
            (LARGE, 5_373_435.0 / LARGE_WORK, S8),
            (LARGE_BYTES, 5_373_435.0 / LARGE_WORK, S8),
            (LARGE, 8_476_055.0 / LARGE_WORK, S16),
        ],
    ),
    (
        "mps2-an386",
        &[
            (SMALL, 12_343_385.0 / SMALL_WORK, S8),
            (SMALL_BYTES, 12_343_385.0 / SMALL_WORK, S8),
            (SMALL, 12_640_535.0 / SMALL_WORK, S16),
            (LARGE, 40_869_795.0 / LARGE_WORK, S8),
            (LARGE_BYTES, 40_869_795.0 / LARGE_WORK, S8),
            (LARGE, 43_352_854.0 / LARGE_WORK, S16),
        ],
    ),
];

/// The convolutions in integers that a library has too, and their multiply-accumulates.
const SMALL: &str = "3x3 convolution 16->16 in integers, 48x48";
const SMALL_WORK: f64 = 5_308_416.0;
const LARGE: &str = "3x3 convolution 32->32 in integers, 48x48";
const LARGE_WORK: f64 = 21_233_664.0;
/// The same with features of 8 bits.
const SMALL_BYTES: &str = "3x3 convolution 16->16 in bytes, 48x48";
const LARGE_BYTES: &str = "3x3 convolution 32->32 in bytes, 48x48";
/// The library with features of 8 bits, and of 16.
const S8: &str = "CMSIS-NN, s8";
const S16: &str = "CMSIS-NN, s16";

/// How the page begins.
pub const START: &str = "# Instructions and memory on the microcontroller\n";

const HEAD: &str = "# Instructions and memory on the microcontroller

Written by `cargo run --release -p ommatidia -- device bench -o docs/instructions.md --force`: the programs of
`firmware/src/bin/bench.rs`, counted instruction by instruction under QEMU, one table per board. The counts repeat
exactly. They do not include pipeline, caches or wait states. An instruction of Helium, the vector extension of the
Cortex-M55, counts as one here and takes two cycles on that core. Transforms read and write half precision (f16),
except the complex ones, which work in place; convolutions and the network read and write half precision. Those *in
integers* have weights of 8 bits and features of 16 (`quantize --weights int8 --activations int16`), those *in bytes*
features of 8 (`--activations int8`). Results have the same bits on every board as on the workstation. The C libraries
work in single precision (f32) or in half precision throughout (f16), whose results may differ between machines, or in
integers, which are exact: weights of 8 bits, features of 8 (s8) or of 16 (s16). Their counts were taken earlier under
QEMU 7.2 with the better of gcc 12 and clang 19; those in integers are of release 7.0.0 of CMSIS-NN, with gcc 12.
`python3 tests/cmsis_nn/count.py FOLDER` repeats the latter for the release in a folder and the compiler that is
installed. It also compares the library's results with those of a plain loop.

A test of `cargo verify` counts again. It fails if a figure has grown by more than 2 %, if a table lacks an operator,
or if a library needs fewer instructions. After an intended change, write the page again with the command above, or
with `OMMATIDIA_RENEW=1 cargo test --release -p ommatidia-tests --test instructions`.
";

/// The tables of a board, Markdown.
pub fn table(counts: &BoardCounts) -> String {
    let Footprint { image_bytes, static_bytes, stack_bytes } = counts.footprint;
    let mut text = format!(
        "| memory of the program | bytes |\n|---|---|\n| code and constants | {image_bytes} |\n| variables | \
            {static_bytes} |\n\
         | deepest stack | {stack_bytes} |\n\n\
         | operator | work | instructions | per unit of work | C libraries, per unit |\n|---|---|---|---|---|\n"
    );
    for count in &counts.operators {
        let OperatorCount { name, amount, unit, instructions } = count;
        let peers: Vec<String> =
            peers(counts.board.name, name).map(|(_, per_unit, who)| format!("{per_unit:.2} ({who})")).collect();
        let (per_unit, peers) = (count.per_unit(), peers.join(", "));
        text += &format!("| {name} | {amount} {unit} | {instructions} | {per_unit:.2} | {peers} |\n");
    }
    text
}

/// The page, Markdown: one section per board, then the frame rates that follow from the counts.
///
/// # Errors
/// The memory plan of a preset fails.
pub fn page(boards: &[BoardCounts]) -> Result<String, DeviceError> {
    let section = |counts: &BoardCounts| format!("\n{}\n\n{}", heading(counts.board), table(counts));
    Ok(HEAD.to_string() + &boards.iter().map(section).collect::<String>() + &rates::section(boards)?)
}

/// Whether the frame rates on a page follow from its tables.
///
/// # Errors
/// The memory plan of a preset fails.
pub fn rates_follow(page: &str) -> Result<bool, DeviceError> {
    let boards: Vec<BoardCounts> = BOARDS.into_iter().filter_map(|board| counts(page, board)).collect();
    let rates = rates::section(&boards)?;
    Ok(!rates.is_empty() && page.ends_with(&rates))
}

/// The counts that a page holds of a board.
fn counts(page: &str, board: Board) -> Option<BoardCounts> {
    let rows = cells(page, board);
    let size = |name: &str| rows.iter().find(|row| row[0] == name)?.get(1)?.parse().ok();
    let footprint = Footprint {
        image_bytes: size("code and constants")?,
        static_bytes: size("variables")?,
        stack_bytes: size("deepest stack")?,
    };
    let operator = |row: &Vec<String>| {
        let (amount, unit) = row.get(1)?.split_once(' ')?;
        let (amount, instructions) = (amount.parse().ok()?, row.get(2)?.parse().ok()?);
        Some(OperatorCount { name: row[0].clone(), amount, unit: unit.into(), instructions })
    };
    Some(BoardCounts { board, footprint, operators: rows.iter().filter_map(operator).collect() })
}

fn heading(board: Board) -> String {
    format!("## {} (`{}`)", board.core, board.name)
}

/// Differences between `counts` and `page`, one line each: figures that have grown by more than 2 %, operators that
/// only one of them has, operators that need more instructions than a library.
pub fn complaints(page: &str, counts: &BoardCounts) -> Vec<String> {
    let committed = read(page, counts.board);
    let Footprint { image_bytes, static_bytes, stack_bytes } = counts.footprint;
    let sizes = [("code and constants", image_bytes), ("variables", static_bytes), ("deepest stack", stack_bytes)];
    let sizes = sizes.into_iter().map(|(name, bytes)| (name, u64::from(bytes)));
    let operators = counts.operators.iter().map(|count| (count.name.as_str(), count.instructions));
    let found: Vec<(&str, u64)> = sizes.chain(operators).collect();
    let mut complaints = Vec::new();
    for (name, now) in &found {
        match committed.iter().find(|(committed, _)| committed == name) {
            None => complaints.push(format!("{name}: not in the table")),
            Some((_, before)) if *now as f64 > *before as f64 * (1.0 + TOLERANCE) => {
                let percent = 100.0 * (*now as f64 / *before as f64 - 1.0);
                complaints.push(format!("{name}: {before} -> {now}, {percent:.1} % more"));
            }
            Some(_) => {}
        }
    }
    for count in &counts.operators {
        let found = count.per_unit();
        let ahead = |peer: &&Peer| found > peer.1;
        for (name, per_unit, who) in peers(counts.board.name, &count.name).filter(ahead) {
            complaints.push(format!("{name}: {found:.2} per unit of work, more than {who} with {per_unit:.2}"));
        }
    }
    let gone = committed.iter().filter(|(name, _)| found.iter().all(|(found, _)| found != name));
    complaints.extend(gone.map(|(name, _)| format!("{name}: in the table, but no longer counted")));
    complaints
}

fn peers(board: &str, operator: &str) -> impl Iterator<Item = &'static Peer> {
    let of_board = PEERS.iter().filter(move |(name, _)| *name == board).flat_map(|(_, peers)| peers.iter());
    of_board.filter(move |(name, ..)| *name == operator)
}

/// Name and figure of each row of a board's tables.
fn read(page: &str, board: Board) -> Vec<(String, u64)> {
    let row = |cells: Vec<String>| {
        let figure = if cells.len() == 2 { cells.get(1)? } else { cells.get(2)? };
        let figure = figure.parse().ok()?;
        Some((cells.into_iter().next()?, figure))
    };
    cells(page, board).into_iter().filter_map(row).collect()
}

/// The rows of a board's tables.
fn cells(page: &str, board: Board) -> Vec<Vec<String>> {
    let row = |line: &str| -> Option<Vec<String>> {
        Some(line.strip_prefix('|')?.strip_suffix('|')?.split('|').map(|cell| cell.trim().into()).collect())
    };
    let heading = heading(board);
    let section = page.lines().skip_while(|line| **line != heading).skip(1);
    section.take_while(|line| !line.starts_with("## ")).filter_map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    use ommatidia_shared::boards::{MPS2_AN386, MPS2_AN500, MPS3_AN547};

    fn count(name: &str, amount: u64, instructions: u64) -> OperatorCount {
        OperatorCount { name: name.into(), amount, unit: "px".into(), instructions }
    }

    fn on(board: Board, operators: &[OperatorCount]) -> BoardCounts {
        let footprint = Footprint { image_bytes: 50_000, static_bytes: 4000, stack_bytes: 5000 };
        BoardCounts { board, footprint, operators: operators.to_vec() }
    }

    #[test]
    fn a_page_agrees_with_the_counts_it_was_written_from() {
        let boards = [MPS2_AN500, MPS3_AN547, MPS2_AN386].map(|board| {
            let instructions = if board == MPS3_AN547 { 70_000 } else { 160_000 };
            on(board, &[count("2-D real FFT 64x64, forward", 4096, instructions), count("a, b", 3, 17)])
        });
        let page = page(&boards).unwrap();
        for counts in &boards {
            assert_eq!(complaints(&page, counts), Vec::<String>::new());
        }
        assert!(page.contains("| 160000 | 39.06 | 59.29 (microfft, f32) |"));
        assert!(page.contains("| 70000 | 17.09 | 25.80 (CMSIS-DSP, f32), 18.60 (CMSIS-DSP, f16) |"));
        assert!(page.contains("| 160000 | 39.06 |  |"), "no library was counted on the Cortex-M4F");
    }

    #[test]
    fn growth_beyond_two_percent_is_reported_and_less_is_not() {
        let page = page(&[on(MPS2_AN500, &[count("a", 1, 1000), count("b", 1, 1000), count("c", 1, 1000)])]).unwrap();
        let mut counts = on(MPS2_AN500, &[count("a", 1, 1020), count("b", 1, 1021), count("c", 1, 500)]);
        counts.footprint.image_bytes = 60_000;
        let found = complaints(&page, &counts);
        assert_eq!(found, ["code and constants: 50000 -> 60000, 20.0 % more", "b: 1000 -> 1021, 2.1 % more"]);
    }

    #[test]
    fn operators_that_come_or_go_are_reported() {
        let page = page(&[on(MPS2_AN500, &[count("a", 1, 1)]), on(MPS3_AN547, &[count("b", 1, 1)])]).unwrap();
        let found = complaints(&page, &on(MPS2_AN500, &[count("b", 1, 1)]));
        assert_eq!(found, ["b: not in the table", "a: in the table, but no longer counted"]);
    }

    #[test]
    fn an_operator_behind_a_library_is_reported_whatever_the_page_says() {
        let counts = on(MPS2_AN500, &[count("3x3 convolution 32->32, 48x48", 100, 149)]);
        assert_eq!(complaints(&page(std::slice::from_ref(&counts)).unwrap(), &counts).len(), 1);
    }
}
