//! Counts the instructions of each operator on an emulated core.

use super::counter::Counter;
use super::emulator::Emulator;
use super::error::DeviceError;
use super::firmware::Firmware;
use super::footprint::{Footprint, footprint};
use super::qemu::run_to_end;
use ommatidia_shared::boards::Board;
use serde::Serialize;

/// Instructions of one operator.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct OperatorCount {
    /// Operator and its shape.
    pub name: String,
    /// Amount of work, in `unit`.
    pub amount: u64,
    /// Unit of the work.
    pub unit: String,
    /// Instructions.
    pub instructions: u64,
}

impl OperatorCount {
    /// Instructions per unit of work.
    pub fn per_unit(&self) -> f64 {
        self.instructions as f64 / self.amount as f64
    }
}

/// Instructions and memory of the firmware on one board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BoardCounts {
    /// The board.
    pub board: Board,
    /// Memory of the firmware.
    pub footprint: Footprint,
    /// Instructions of each operator.
    pub operators: Vec<OperatorCount>,
}

/// Builds the programs for a board, runs them under QEMU, and counts their instructions.
///
/// # Errors
/// QEMU, a compiler or the sources are missing, or a program fails.
pub fn count_board(board: Board) -> Result<BoardCounts, DeviceError> {
    let operators = count_operators(&Firmware::build(board, "bench")?)?;
    Ok(BoardCounts { board, footprint: footprint(&Firmware::build(board, "app")?)?, operators })
}

/// Runs the `bench` program and counts each of its regions.
///
/// # Errors
/// QEMU, the C compiler or the image is missing, or the program fails.
fn count_operators(bench: &Firmware) -> Result<Vec<OperatorCount>, DeviceError> {
    let counter = Counter::build(&Emulator::find()?)?;
    let printed = run_to_end(bench, Some(&counter))?;
    let mut counts = Vec::new();
    let regions = counter.regions()?;
    let lines: Vec<&str> = printed.lines().filter(|line| line.contains('\t')).collect();
    if lines.len() != regions.len() {
        let status = format!("{} regions announced, {} counted", lines.len(), regions.len());
        return Err(DeviceError::Stopped { status, output: printed });
    }
    for (line, instructions) in lines.into_iter().zip(regions) {
        let mut fields = line.split('\t');
        let (name, amount, unit) = (fields.next(), fields.next().and_then(|n| n.parse().ok()), fields.next());
        let (Some(name), Some(amount), Some(unit)) = (name, amount, unit) else {
            let status = "a line is not `name, amount, unit`".into();
            return Err(DeviceError::Stopped { status, output: line.into() });
        };
        counts.push(OperatorCount { name: name.into(), amount, unit: unit.into(), instructions });
    }
    Ok(counts)
}
