//! The page `docs/faults.md`: written, and compared with new trials.

use super::tally::Row;

/// How the page begins.
pub const START: &str = "# Fault injection\n";

const HEAD: &str = "# Fault injection

Written by `cargo run --release -p ommatidia -- device faults -o docs/faults.md --force`. The table lists the injected
faults, how many of each, and whether networks and frames survived (`host/program/src/device/faults`). A test of `cargo
verify` injects all of them again. It fails if a network or a frame is lost, if a bit of a reconstruction is wrong, or
if a number differs from this page. `OMMATIDIA_RENEW=1 cargo test --release -p ommatidia-tests --test faults` writes
the page again.

The flash is simulated NOR flash: a step writes one word of 4 bytes or erases one sector of 4 KiB. When the power
fails within a step, a random part of the bits of that step has changed. Flash with error correction is that of the
STM32H7: a word has 32 bytes, and of those that were being written or erased seven in eight cannot be read until their
sector is erased; nor can a word that was written twice. Reading such a word would be a fault of the bus, so the device
looks first (`MappedFlash::view`), and the simulated flash lends no bytes of it. A network counts as lost if no network
runs after the next start, or if another one runs than the one whose commit the device had acknowledged. A frame counts
as lost if it cannot be reconstructed afterwards, after a new upload where that is needed. `seen` counts the faults that
the device or the host noticed. On the serial line it counts the injected faults: each costs a packet, which the host
requests again.

";

/// The table, Markdown.
pub fn table(rows: &[Row]) -> String {
    let mut text = String::from(
        "| fault | how | tried | seen | networks lost | frames lost | wrong reconstructions \
            |\n|---|---|---|---|---|---|---|\n",
    );
    for Row { fault, how, tried, seen, blobs_lost, frames_lost, wrong } in rows {
        text += &format!("| {fault} | {how} | {tried} | {seen} | {blobs_lost} | {frames_lost} | {wrong} |\n");
    }
    let sum = |field: fn(&Row) -> u64| rows.iter().map(field).sum::<u64>();
    let lost = [sum(|row| row.blobs_lost), sum(|row| row.frames_lost), sum(|row| row.wrong)];
    text += &format!(
        "| **all** | | **{}** | | **{}** | **{}** | **{}** |\n",
        sum(|row| row.tried),
        lost[0],
        lost[1],
        lost[2]
    );
    text
}

/// The page: the table and what it says.
pub fn page(rows: &[Row]) -> String {
    format!("{HEAD}{}", table(rows))
}

/// What is wrong with `rows`, one line each: losses, and rows that are not in `page`.
pub fn complaints(page: &str, rows: &[Row]) -> Vec<String> {
    let mut complaints = Vec::new();
    for row in rows {
        if row.blobs_lost + row.frames_lost + row.wrong > 0 {
            complaints.push(format!("lost: {row:?}"));
        }
        let line = table(std::slice::from_ref(row));
        if !line.lines().nth(2).is_some_and(|line| page.contains(line)) {
            complaints.push(format!("not in the table: {row:?}"));
        }
    }
    complaints
}
