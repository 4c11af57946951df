//! The table of instructions in `docs/instructions.md`: written, read back, and compared with new counts.

use super::OperatorCount;

/// How much a count may grow before the page must be written anew: another compiler arranges what stands round the loops a little
/// differently.
const TOLERANCE: f64 = 0.02;

/// What the best C library for the core takes for the same work, instructions per unit of it: counted under QEMU 7.2, the better of gcc
/// 12 (-O3, -Ofast) and clang 19.
const PEERS: [(&str, f64, &str); 4] = [
    ("2-D real FFT 64x64, forward", 242_856.0 / 4096.0, "microfft, f32"),
    ("2-D real FFT 64x64, filter, inverse", 574_135.0 / 4096.0, "CMSIS-DSP, f32"),
    ("2-D real FFT 128x128, filter, inverse", 2_399_654.0 / 16384.0, "CMSIS-DSP, f32"),
    ("3x3 convolution 32->32, 48x48", 1.48, "best C"),
];

const HEAD: &str = "# Instructions on the Cortex-M7

Written by `cargo run --release -p ommatidia-host -- device bench -o docs/instructions.md`: the programs of
`firmware/src/bin/bench.rs`, counted instruction by instruction under QEMU (`mps2-an500`). The counts repeat exactly. They know
nothing of pipeline, caches or wait states. Transforms start from halves and end in halves, but for the complex ones in place;
convolutions and the network read and write halves. The libraries work on singles; their counts were taken earlier under QEMU
7.2 (the better of gcc 12 and clang 19) and are not repeated by the command.

A test of `cargo verify` counts anew and fails where a count has grown by more than 2 %, where the table lacks an operator, or where a
library is ahead. After a change that is meant, write the page anew with the command above, or by
`OMMATIDIA_RENEW=1 cargo test --release -p ommatidia-tests --test instructions`.

";

/// The table, Markdown.
pub fn table(counts: &[OperatorCount]) -> String {
    let mut text = String::from(
        "| operator | work | instructions | per unit of work | best C library, per unit |\n|---|---|---|---|---|\n",
    );
    for count in counts {
        let OperatorCount { name, amount, unit, instructions } = count;
        let peer = peer(name).map_or(String::new(), |(per_unit, who)| format!("{per_unit:.2} ({who})"));
        text += &format!("| {name} | {amount} {unit} | {instructions} | {:.2} | {peer} |\n", count.per_unit());
    }
    text
}

/// The page: the table and what it says.
pub fn page(counts: &[OperatorCount]) -> String {
    format!("{HEAD}{}", table(counts))
}

/// What is wrong with `counts`, one line each: counts that have grown beyond those of `page`, operators that only one of them has,
/// operators behind a library.
pub fn complaints(page: &str, counts: &[OperatorCount]) -> Vec<String> {
    let committed = read(page);
    let mut complaints = Vec::new();
    for count in counts {
        let OperatorCount { name, instructions, .. } = count;
        match committed.iter().find(|(committed, _)| committed == name) {
            None => complaints.push(format!("{name}: not in the table")),
            Some((_, before)) if *instructions as f64 > *before as f64 * (1.0 + TOLERANCE) => {
                let percent = 100.0 * (*instructions as f64 / *before as f64 - 1.0);
                complaints.push(format!("{name}: {before} -> {instructions} instructions, {percent:.1} % more"));
            }
            Some(_) => {}
        }
        if let Some((per_unit, who)) = peer(name).filter(|(per_unit, _)| count.per_unit() > *per_unit) {
            complaints.push(format!("{name}: {:.2} a unit of work, behind {who} with {per_unit:.2}", count.per_unit()));
        }
    }
    let gone = committed.iter().filter(|(name, _)| counts.iter().all(|count| count.name != *name));
    complaints.extend(gone.map(|(name, _)| format!("{name}: in the table, but no longer counted")));
    complaints
}

fn peer(name: &str) -> Option<(f64, &'static str)> {
    PEERS.iter().find(|(operator, ..)| *operator == name).map(|&(_, per_unit, who)| (per_unit, who))
}

/// Operator and instructions of each row.
fn read(page: &str) -> Vec<(String, u64)> {
    let row = |line: &str| {
        let mut cells = line.strip_prefix('|')?.split('|').map(str::trim);
        let (name, instructions) = (cells.next()?, cells.nth(1)?.parse().ok()?);
        Some((name.to_string(), instructions))
    };
    page.lines().filter_map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(name: &str, amount: u64, instructions: u64) -> OperatorCount {
        OperatorCount { name: name.into(), amount, unit: "px".into(), instructions }
    }

    #[test]
    fn a_page_agrees_with_the_counts_it_was_written_from() {
        let counts = [count("2-D real FFT 64x64, forward", 4096, 160_000), count("a, b", 3, 17)];
        assert_eq!(complaints(&page(&counts), &counts), Vec::<String>::new());
        assert!(page(&counts).contains("| 160000 | 39.06 | 59.29 (microfft, f32) |"));
    }

    #[test]
    fn growth_beyond_two_percent_is_told_and_less_is_not() {
        let page = page(&[count("a", 1, 1000), count("b", 1, 1000), count("c", 1, 1000)]);
        let found = complaints(&page, &[count("a", 1, 1020), count("b", 1, 1021), count("c", 1, 500)]);
        assert_eq!(found, ["b: 1000 -> 1021 instructions, 2.1 % more"]);
    }

    #[test]
    fn operators_that_come_or_go_are_told() {
        let found = complaints(&page(&[count("a", 1, 1)]), &[count("b", 1, 1)]);
        assert_eq!(found, ["b: not in the table", "a: in the table, but no longer counted"]);
    }

    #[test]
    fn an_operator_behind_a_library_is_told_whatever_the_page_says() {
        let counts = [count("3x3 convolution 32->32, 48x48", 100, 149)];
        assert_eq!(complaints(&page(&counts), &counts).len(), 1);
    }
}
