//! Arbitrary bytes as a network file: they are refused, or are a network that runs in the memory of its plan.
//!
//! Every second input gets the right magic, version, schema, length and checksum, so that it passes the first checks.

use half::f16;
use ommatidia_shared::blob::{MAGIC, Network, SCHEMA_KEY, VERSION};
use ommatidia_shared::pipeline::{Memory, Pipeline};
use ommatidia_shared::watch::{BASELINE, Watch};
use ommatidia_shared::wire::checksum;

/// Largest length of a buffer, numbers: larger networks are not run.
const MAX_NUMBERS: usize = 1 << 18;

/// Tries one input. Panics where the module's claim does not hold.
pub fn try_input(data: &[u8]) {
    let Some((forge, bytes)) = data.split_first() else { return };
    let mut words = vec![0u128; bytes.len().div_ceil(16)];
    let file = &mut bytemuck::cast_slice_mut::<_, u8>(&mut words)[..bytes.len()];
    file.copy_from_slice(bytes);
    if forge % 2 == 1 && file.len() >= 36 {
        forged(file);
    }
    let Ok(network) = Network::decode(file) else { return };
    let Ok(pipeline) = Pipeline::new(&network) else { return };
    if [pipeline.fast_len(), pipeline.bulk_len(), pipeline.frame_len()].iter().any(|len| *len > MAX_NUMBERS) {
        return;
    }
    let (mut fast, mut bulk) = (vec![0.0; pipeline.fast_len()], vec![f16::ZERO; pipeline.bulk_len()]);
    let mut object = vec![f16::NAN; pipeline.output_len()];
    let frame: Vec<u16> = (0..pipeline.frame_len()).map(|i| (i * 7919 % 4096) as u16).collect();
    if let Some(maps) = network.watch() {
        let mut watch = Watch::new();
        (0..BASELINE + 3).for_each(|id| watch.see(&maps, &frame, 0, id));
        assert_eq!(watch.report(&maps).lenses as usize, maps.lenses());
    }
    pipeline.run(&frame, Memory { fast: &mut fast, bulk: &mut bulk }, &mut object).expect("the plan is enough");
    assert!(object.iter().all(|half| half.is_finite()));
}

/// Sets everything before the header, and the checksum, to valid values.
fn forged(file: &mut [u8]) {
    file[..8].copy_from_slice(&MAGIC);
    file[8..10].copy_from_slice(&VERSION.to_le_bytes());
    file[16..24].copy_from_slice(&SCHEMA_KEY.to_le_bytes());
    let len = file.len();
    file[24..28].copy_from_slice(&(len as u32).to_le_bytes());
    let crc = checksum(&file[..len - 4]);
    file[len - 4..].copy_from_slice(&crc.to_le_bytes());
}
