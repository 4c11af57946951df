//! The page `docs/faults.md`: written, and compared with new trials.

use super::Row;

const HEAD: &str = "# Faults tried

Written by `cargo run --release -p ommatidia-host -- device faults -o docs/faults.md`: faults put in on purpose, by kind and number,
and what became of networks and frames (`host/src/device/faults`). A test of `cargo verify` tries all of them anew and fails where a
network or a frame is lost, a bit of a reconstruction is wrong, or a number differs from this page; `OMMATIDIA_RENEW=1 cargo test
--release -p ommatidia-tests --test faults` writes the page anew.

The flash is NOR flash in memory: a step is a word of 4 bytes written or a sector of 4 KiB erased; within a step, any of the bits that
were to change have changed when the power goes. A network counts as lost where none runs after the next start, or not the one
whose commit the device had acknowledged; a frame, where it cannot be reconstructed after that, with a new upload if need be. On the line, `seen` counts
what was put in: each costs a packet, which is asked for again.

";

/// The table, Markdown.
pub fn table(rows: &[Row]) -> String {
    let mut text = String::from(
        "| fault | how | tried | seen | networks lost | frames lost | wrong reconstructions |\n|---|---|---|---|---|---|---|\n",
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
