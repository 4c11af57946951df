//! Frame rates of each preset on microcontrollers: counted instructions, assumed cycles per instruction, planned
//! memory.
//!
//! The counts can come from the page that [`super::table`] writes:
//!
//! ```
//! use ommatidia::device::{BoardCounts, Footprint, OperatorCount, rates};
//! use ommatidia_shared::boards::MPS2_AN500;
//!
//! let convolution = OperatorCount { name: "3x3".into(), amount: 1000, unit: "MAC".into(), instructions: 1130 };
//! assert_eq!(convolution.per_unit(), 1.13);
//!
//! // Without a count of every operator of a network there is no estimate, and the section is empty.
//! let footprint = Footprint { image_bytes: 110_000, static_bytes: 4_360, stack_bytes: 7_600 };
//! let counts = BoardCounts { board: MPS2_AN500, footprint, operators: vec![convolution] };
//! assert_eq!(rates::section(&[counts])?, "");
//! # Ok::<(), ommatidia::device::DeviceError>(())
//! ```

use super::count::BoardCounts;
use super::error::DeviceError;
use clap::ValueEnum;
use ommatidia_network::quantize::BLOCK;
use ommatidia_network::train::Preset;
use ommatidia_shared::blob::{Bank, Blocks, Header, MemoryPlan, Rcan, Sensor, Size, Tap};
use ommatidia_shared::boards::{Board, MPS2_AN386, MPS2_AN500, MPS3_AN547};
use ommatidia_shared::filter::{Axis, Geometry};
use ommatidia_shared::image::Region;
use ommatidia_shared::nn::rcan::{Entry, Layer, Rcan as RcanPlan, layout};
use ommatidia_shared::pipeline::Pipeline;
use std::ops::Range;

/// A microcontroller on the market.
struct Part {
    name: &'static str,
    /// The emulated board with its core.
    board: Board,
    mhz: f64,
    /// Cycles per instruction, assumed.
    cycles: f64,
    ram_kib: u64,
    /// `None`: external flash of any size.
    flash_kib: Option<u64>,
}

const PARTS: [Part; 4] = [
    Part { name: "STM32H743", board: MPS2_AN500, mhz: 480.0, cycles: 1.0, ram_kib: 992, flash_kib: Some(2048) },
    Part { name: "i.MX RT1176", board: MPS2_AN500, mhz: 1000.0, cycles: 1.0, ram_kib: 2048, flash_kib: None },
    Part { name: "STM32N657", board: MPS3_AN547, mhz: 800.0, cycles: 2.0, ram_kib: 4300, flash_kib: None },
    Part { name: "ATSAMD51J20", board: MPS2_AN386, mhz: 120.0, cycles: 3.0, ram_kib: 256, flash_kib: Some(1024) },
];

const HEAD: &str = "
## Frame rates

Frames per second = clock / (instructions per frame x cycles per instruction). The cycles per instruction are assumed,
not measured on hardware. Cortex-M7: one, on the assumption that its second pipeline compensates for wait states.
Cortex-M55: two, as if all instructions were Helium's (Arm: two beats of 64 bits on this core). Cortex-M4F: three, as
if all instructions were `VFMA` (Arm DDI 0439, table 7-1). On the last two, real frames take less. The transfer over
the serial line and the exposure are not included.

The instructions of frames of 214x214 pixels were counted under QEMU (tables above). Pruned filters take a tenth of
the flash (`quantize --prune 0.1`) and are transformed on the device. Frames with pruned filters were counted for
`nano`; for the other presets the transforms of kernels without an empty row are added. Frames of 608x608 pixels, the
sensor of the wire-free miniscopes, were not counted. Their instructions are estimated: the numbers of
multiply-accumulates, transforms, tiles and pixels times the cost of each in the tables above, with transforms of
128x128 in steps of 64 and nine taps per channel. The estimate does not include the correction of the sensor";

const HELD: &str = " Rows
marked *field held* are for a square in the middle of the object (`device stream --roi --hold`): of ten frames one is \
exact, and nine
take the statistics of the field from it. Their figures are means over the ten.";

const TABLE: &str = "

| network | part | instructions per frame | frames per second | RAM, KiB | flash, KiB |
|---|---|---|---|---|---|
";

/// Frames with the field held per exact frame: the default of `--hold`.
const HOLD: f64 = 9.0;

/// A preset on frames of one size.
#[derive(Clone)]
struct Network {
    preset: String,
    header: Header,
    /// Side of the square in the middle that is wanted, the field held; all of the object where there is none.
    square: Option<u16>,
}

impl Network {
    /// Dense filters where `taps` is empty, else these offsets in steps of 64 pixels.
    fn new(preset: Preset, frame: u16, object: u16, taps: &[i8]) -> Result<Self, DeviceError> {
        let network = preset.network([frame.into(); 2], [object.into(); 2]);
        let [channels, width, groups, blocks, reduction] =
            [network.channels, network.width, network.groups, network.blocks, network.reduction].map(|n| n as u8);
        let (tile, step) =
            if taps.is_empty() { (network.filter_size as u16, network.filter_size as u16) } else { (128, 64) };
        let offsets: &[i8] = if taps.is_empty() { &[0] } else { taps };
        let of_channel =
            |channel| offsets.iter().flat_map(move |&dy| offsets.iter().map(move |&dx| Tap { channel, dy, dx }));
        let mut header = Header {
            name: Default::default(),
            checkpoint: Default::default(),
            frame: Size { rows: frame, cols: frame },
            object: Size { rows: object, cols: object },
            sensor: Sensor { black_level_dn: 64.0, saturation_dn: 4095, has_offset_map: true, has_gain_map: true },
            bank: Bank { tile, step, channels, taps: (0..channels).flat_map(of_channel).collect(), blocks: None },
            rcan: Rcan { width, groups, blocks, reduction },
            memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
            integers: None,
            passes: None,
            watch: None,
        };
        header.memory = Pipeline::plan(&header).map_err(DeviceError::Pipeline)?;
        let preset = preset.to_possible_value().map_or_else(String::new, |name| name.get_name().to_string());
        Ok(Self { preset, header, square: None })
    }

    /// The same with dense filters pruned to a tenth of their bytes.
    fn pruned(&self) -> Result<Self, DeviceError> {
        let mut header = self.header.clone();
        let (tile, channels) = (u32::from(header.bank.tile), u32::from(header.bank.channels));
        let side = BLOCK as u32;
        let index = 2 * (channels * tile / side + 1);
        let count = (channels * 2 * tile * (tile + 2) / 10 - index) / (2 * side * side + 2);
        header.bank.blocks = Some(Blocks { side: side as u16, count: count as u16 });
        header.memory = Pipeline::plan(&header).map_err(DeviceError::Pipeline)?;
        Ok(Self { preset: format!("{}, filters pruned", self.preset), header, square: None })
    }

    /// The same for a square in the middle, the field held.
    fn held(&self, side: u16) -> Self {
        Self { square: Some(side), ..self.clone() }
    }

    fn name(&self) -> String {
        let Header { frame, object, .. } = &self.header;
        let whole = format!(
            "`{}` network, {}x{} px to {}x{} px",
            self.preset, frame.rows, frame.cols, object.rows, object.cols
        );
        self.square.map_or(whole.clone(), |side| format!("{whole}, {side}x{side} px in the middle, field held"))
    }

    /// Counted instructions per frame; `None` where they were not counted.
    fn counted(&self, counts: &BoardCounts) -> Option<f64> {
        let find = |name: String| counts.operators.iter().find(|count| count.name == name);
        let count = |name: String| find(name).map(|count| count.instructions as f64);
        let whole = count(format!("whole {}", Self { square: None, ..self.clone() }.name()))?;
        let Some(side) = self.square else { return Some(whole) };
        let square = |what: &str| count(format!("`{}` network, {side}x{side} px in the middle{what}", self.preset));
        Some((square(" alone")? + HOLD * square(", field held")?) / (HOLD + 1.0))
    }

    /// Instructions per frame, estimated from the costs of its operators; the exact frame among the held ones covers
    /// the whole object. `None` where an operator was not counted.
    fn estimated(&self, counts: &BoardCounts) -> Option<f64> {
        let Header { object, .. } = &self.header;
        let whole = self.sum(counts, Region::whole(object.rows, object.cols), false)?;
        let Some(side) = self.square else { return Some(whole) };
        let (row, col) = ((object.rows - side) / 2, (object.cols - side) / 2);
        let held = self.sum(counts, Region { row, col, rows: side, cols: side }, true)?;
        Some((whole + HOLD * held) / (HOLD + 1.0))
    }

    /// Instructions of a region, exact where it is the whole.
    fn sum(&self, counts: &BoardCounts, region: Region, held: bool) -> Option<f64> {
        let find = |name: &str| counts.operators.iter().find(|count| count.name == name);
        let cost = |name: String| find(&name).map(|count| count.per_unit());
        let Header { object, bank, rcan, .. } = &self.header;
        let plan = RcanPlan::new(*rcan, self.header.integers, bank.channels, *object).ok()?;
        // The costs of 16 channels hold for those of 24, and are a little above.
        let width = if rcan.width < 32 { 16 } else { 32 };
        let mut left = plan.depth();
        let mut sum = 0.0;
        for Entry { layer, outputs, inputs, kernel } in layout(rcan, bank.channels) {
            let px = plan.window(region, left).pixels() as f64;
            let (macs, features) = ((outputs * inputs * kernel * kernel) as f64 * px, f64::from(rcan.width) * px);
            let conv = |what: &str| cost(format!("3x3 convolution {width}->{width}{what}, 48x48"));
            sum += match layer {
                Layer::Head => macs * cost("3x3 convolution 24->16 of the unshuffled, 48x48".into())?,
                Layer::BlockConv { conv: 0, .. } => macs * conv(" and ReLU")?,
                Layer::BlockConv { .. } => macs * conv("")?,
                Layer::GroupConv { .. } | Layer::Conv1 => macs * conv(" and skip")?,
                // Nothing is measured where it is held.
                Layer::Squeeze { .. } if held => 0.0,
                Layer::Squeeze { .. } => features * cost(format!("channel attention, {width} channels, 48x48"))?,
                Layer::Excite { .. } => features * cost("attention times features and skip, 1024".into())?,
                Layer::Upscale => macs * cost(format!("pixel shuffle {width}->1 with its convolutions, to 96x96"))?,
                Layer::Conv2 => 4.0 * macs * cost(format!("pixel shuffle {width}->1 with its convolutions, to 96x96"))?,
            };
            left -= usize::from(kernel == 3 && left > 1);
        }
        let part = plan.input(region, held);
        Some(sum + self.filters(part, &|name| find(&name).map(|count| count.instructions as f64), &cost)?)
    }

    /// Transforms and products of the filters for a part of the object.
    fn filters(
        &self,
        part: Region,
        total: &dyn Fn(String) -> Option<f64>,
        cost: &dyn Fn(String) -> Option<f64>,
    ) -> Option<f64> {
        let Header { frame, object, bank, .. } = &self.header;
        let Geometry { rows, cols } = Geometry::new(bank, *frame, *object).ok()?;
        let side = bank.tile;
        let forward = total(format!("2-D real FFT {side}x{side}, forward"))?;
        let inverse = total(format!("2-D real FFT {side}x{side}, filter, inverse"))? - forward;
        let [down, across] = part.ranges();
        let [down, across] = [rows.tiles_of(&down), cols.tiles_of(&across)];
        let lit = |axis: Axis, tiles: &Range<usize>| {
            let (first, last) = (*axis.windows(tiles.start).start(), *axis.windows(tiles.end - 1).end());
            (first..=last).filter(|&i| !axis.occupied(i).is_empty()).count()
        };
        let tiles = (down.len() * across.len()) as f64;
        let windows = (lit(rows, &down) * lit(cols, &across)) as f64;
        // One product is in the count of the inverse.
        let products = tiles * (bank.taps.len() - usize::from(bank.channels)) as f64;
        let macs = 4.0 * f64::from(side) * f64::from(side / 2 + 1);
        let product = macs * cost("filter times spectrum, a column of 256".into())?;
        // Kernels in space are transformed, most of their rows at least.
        let kernels = if bank.blocks.is_some() { f64::from(bank.channels) * forward } else { 0.0 };
        let inverses = tiles * f64::from(bank.channels) * inverse;
        Some(kernels + windows * forward + inverses + products * product)
    }

    fn row(&self, part: &Part, counts: &BoardCounts) -> Option<String> {
        let instructions = self.counted(counts).or_else(|| self.estimated(counts))?;
        let about = if self.counted(counts).is_some() { "" } else { "about " };
        let rate = part.mhz * 1e6 / (instructions * part.cycles);
        let lens = self.header.section_lens().ok()?;
        let maps = lens.offset_dn + lens.inverse_gain;
        let words = lens.filters + lens.index + lens.rcan + maps + lens.integers + lens.channels;
        // The header takes less than a kilobyte.
        let flash = kib(u64::from(counts.footprint.image_bytes) + 2 * words) + 1;
        let Header { frame, object, memory, .. } = &self.header;
        let planes = [frame, object].map(|size| 2 * u64::from(size.rows) * u64::from(size.cols));
        let program = counts.footprint.static_bytes + counts.footprint.stack_bytes;
        let fixed = [memory.fast_bytes, memory.bulk_bytes, program].into_iter().map(u64::from).sum::<u64>();
        let ram = kib(fixed + planes.into_iter().sum::<u64>());
        let name = self.name();
        let of = |needed: u64, there: Option<u64>| match there {
            Some(there) if needed > there => format!("{needed} of {there}: **does not fit**"),
            Some(there) => format!("{needed} of {there}"),
            None => format!("{needed}, outside the chip"),
        };
        Some(format!(
            "| {name} | {} | {about}{:.0} million | {} | {} | {} |\n",
            part.name,
            instructions / 1e6,
            if rate < 0.995 { format!("{rate:.2}") } else { format!("{rate:.1}") },
            of(ram, Some(part.ram_kib)),
            of(flash, part.flash_kib),
        ))
    }
}

fn kib(bytes: u64) -> u64 {
    bytes.div_ceil(1024)
}

/// The section on frame rates, Markdown; empty if no network was counted.
///
/// # Errors
/// The memory plan of a preset fails.
pub fn section(boards: &[BoardCounts]) -> Result<String, DeviceError> {
    let presets = [Preset::Nano, Preset::Lite, Preset::Paper];
    let small = presets.map(|preset| Network::new(preset, 214, 96, &[])).into_iter().collect::<Result<Vec<_>, _>>()?;
    let pruned = small.iter().map(Network::pruned).collect::<Result<Vec<_>, _>>()?;
    let large =
        presets.map(|preset| Network::new(preset, 608, 304, &[-2, 0, 2])).into_iter().collect::<Result<Vec<_>, _>>()?;
    let squares = [small[0].held(48), small[0].held(16)];
    let large_squares: Vec<Network> = large.iter().map(|network| network.held(48)).collect();
    let of = |board: Board| boards.iter().find(|counts| counts.board == board);
    let rows: String = small
        .iter()
        .chain(&pruned)
        .chain(&squares)
        .chain(&large)
        .chain(&large_squares)
        .flat_map(|network| PARTS.iter().filter_map(move |part| network.row(part, of(part.board)?)))
        .collect();
    // How far the sum is off where the count is known.
    let off = |counts| {
        small
            .iter()
            .filter_map(move |network: &Network| Some(network.estimated(counts)? / network.counted(counts)? - 1.0))
    };
    let (low, high) = boards.iter().flat_map(off).fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
    if rows.is_empty() || low > high {
        return Ok(String::new());
    }
    let check = format!("; for the counted networks it deviates by {:+.1} to {:+.1} %.", 100.0 * low, 100.0 * high);
    Ok([HEAD, &check, HELD, TABLE, &rows].concat())
}
