//! Real measurements: the method on other real optics. Where the data are absent these tests count as skipped.
#![allow(clippy::unwrap_used)]

use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
use ommatidia_session::{Role, Session};
use ommatidia_tests::measured_data;

#[test]
fn measured_sessions_open() {
    let Some(sessions) = measured_data("measured_sessions_open", "sessions") else { return };
    let session = Session::open(sessions.join("fibre")).unwrap();
    let bead = session.need(Role::Bead).unwrap()[0];
    assert_eq!(bead.len(), 169);
    assert_eq!((bead.info()[0].x_um, bead.info()[0].y_um), (-143.76, -143.76));
    let frame = bead.frames().unwrap().read(84).unwrap();
    assert_eq!(frame.dim(), (360, 360));
    assert!(frame.iter().any(|v| *v > 100.0));
    let tardigrade = Session::open(sessions.join("tardigrade")).unwrap();
    assert_eq!(tardigrade.stacks()[0].frames().unwrap().read(0).unwrap().dim(), (1100, 1100));
}

/// Focal spots of a fibre microscope, 13 x 13, strongly field-dependent. With the checkerboard held out, one PSF misses
/// them by 0.298 (known from the data's own analysis).
#[test]
fn measured_spots_are_predicted_where_they_were_left_out() {
    let Some(folder) = measured_data("measured_spots_are_predicted_where_they_were_left_out", "sessions/fibre") else {
        return;
    };
    let session = Session::open(&folder).unwrap();
    let config = CalibrateConfig { normalise_beads: Some(true), ..CalibrateConfig::default() };
    let q = calibrate(&session, &config, || {}).unwrap().instrument.quality;
    assert!(q.off_grid_error <= 0.12, "{q:?}");
    // It is seen in the data that brightness is not physical, and said.
    let decided = calibrate(&session, &CalibrateConfig::default(), || {}).unwrap();
    assert_eq!(decided.instrument.quality.off_grid_error, q.off_grid_error);
    assert!(decided.notes.iter().any(|note| note.contains("--normalise-beads")), "{:?}", decided.notes);
    let config = CalibrateConfig { normalise_beads: Some(false), ..CalibrateConfig::default() };
    let raw = calibrate(&session, &config, || {}).unwrap().instrument.quality;
    assert!((raw.one_psf_error - 0.298).abs() < 0.002, "{raw:?}");
}

/// The same spots, of an instrument that knows one PSF: a new calibration by one colour of the checkerboard predicts
/// the spots of the other.
#[test]
fn measured_spots_call_for_a_new_calibration() {
    use ommatidia_closing::search::{held_out_figures, trial_calibration};
    let Some(folder) = measured_data("measured_spots_call_for_a_new_calibration", "sessions/fibre") else { return };
    let session = Session::open(&folder).unwrap();
    let config = CalibrateConfig { normalise_beads: Some(true), replicates: 0, ..CalibrateConfig::default() };
    let one = calibrate(&session, &CalibrateConfig { one_psf: true, ..config }, || {}).unwrap().instrument;
    let first = trial_calibration(&session, &one, &config).unwrap().unwrap();
    let [before, after] = [&one, &first].map(|i| held_out_figures(&session, i).unwrap().nrmse);
    assert!((0.24..0.3).contains(&before) && after <= 0.12, "{before} {after}");
    // Nothing is gained by doing it again.
    assert!(trial_calibration(&session, &first, &config).unwrap().is_none());
}

/// A bead moved through the focus of a microscope with an engineered pupil: a model of one plane misses all others, and
/// a new calibration by every second plane predicts those between.
#[test]
fn measured_depth_calls_for_a_new_calibration() {
    use ommatidia_closing::search::{held_out_figures, trial_calibration};
    let Some(data) = measured_data("measured_depth_calls_for_a_new_calibration", "engineered_psf") else { return };
    for (mask, frames) in [("crlb1", 56), ("tetrapod", 54)] {
        let folder = tempfile::tempdir().unwrap();
        std::fs::copy(data.join(format!("bead_stack_{mask}.tif")), folder.path().join("bead.tif")).unwrap();
        let z_um = |i: usize| 0.1 * i as f64 - 0.05 * (frames - 1) as f64;
        let rows: String = (0..frames).map(|i| format!("{i},0,0,{:.3}\n", z_um(i))).collect();
        std::fs::write(folder.path().join("bead.csv"), format!("frame,x_um,y_um,z_um\n{rows}")).unwrap();
        std::fs::write(folder.path().join("session.toml"), ONE_BEAD).unwrap();
        let session = Session::open(folder.path()).unwrap();
        let config = CalibrateConfig { normalise_beads: Some(true), replicates: 0, ..CalibrateConfig::default() };
        let mut one = calibrate(&session, &config, || {}).unwrap().instrument;
        one.psf = one.psf.at_depth(0.0);
        let first = trial_calibration(&session, &one, &config).unwrap().unwrap();
        let [before, after] = [&one, &first].map(|i| held_out_figures(&session, i).unwrap().nrmse);
        assert!(before > 0.6 && after < 0.2, "{mask} {before} {after}");
    }
}

/// A cell that fades to 28 % under a camera whose gain is about 1.15 DN/e- (1.1 to 1.2 by hand): no darks, no flats,
/// and both ends of the movie tell it.
#[test]
fn measured_movie_tells_the_gain() {
    let Some(data) = measured_data("measured_movie_tells_the_gain", "engineered_psf") else { return };
    for part in ["001-100", "401-500"] {
        let folder = tempfile::tempdir().unwrap();
        let file = data.join(format!("livecell_psf1_frames{part}.tif"));
        std::fs::copy(file, folder.path().join("scene.tif")).unwrap();
        std::fs::write(folder.path().join("session.toml"), LIVE_CELL).unwrap();
        let session = Session::open(folder.path()).unwrap();
        let noise = calibrate(&session, &CalibrateConfig::default(), || {}).unwrap().instrument.noise;
        let (gain, sigma) = (noise.gain_dn_per_e, noise.gain_sigma);
        assert!(sigma < 0.12 && (gain - 1.15).abs() < 2.0 * sigma, "{part} {gain} {sigma}");
    }
}

const LIVE_CELL: &str = r#"format = 1
name = "live cell"
[sensor]
rows = 256
cols = 256
pixel_pitch_um = 11.0
bit_depth = 16
[array]
rows = 1
cols = 1
pitch_px = 0.0
[optics]
magnification = 1.0
psf_window_px = 15
[object]
rows = 256
cols = 256
pixel_um = 11.0
[[stack]]
role = "scene"
file = "scene.tif"
exposure_ms = 100.0
"#;

const ONE_BEAD: &str = r#"format = 1
name = "one bead through an engineered pupil"
[sensor]
rows = 121
cols = 121
pixel_pitch_um = 11.0
bit_depth = 16
[array]
rows = 1
cols = 1
pitch_px = 0.0
[optics]
magnification = 100.0
psf_window_px = 61
[object]
rows = 31
cols = 31
pixel_um = 0.11
[[stack]]
role = "bead"
file = "bead.tif"
exposure_ms = 1.0
table = "bead.csv"
"#;

/// Maps of the gain and the offset of real pixels, on the virtual instrument: both are named, and what they did to
/// scenes that no fit has seen is taken out.
#[test]
fn measured_pixel_maps_are_named_and_corrected() {
    use ommatidia_closing::study::instruments::gentle;
    use ommatidia_closing::{Budget, CloseOptions, Observations, close};
    use ommatidia_physics::effects::EffectSetting;
    use ommatidia_session::FrameReader;
    let Some(data) = measured_data("measured_pixel_maps_are_named_and_corrected", "scmos_maps") else { return };
    let mut bench = gentle(0);
    (bench.scan.rows, bench.scan.cols, bench.scan.depths_um) = (9, 9, vec![0.0]);
    let folder = tempfile::tempdir().unwrap();
    let measure = |name: &str, effects: &[EffectSetting]| {
        bench.build(effects).unwrap().measure(&folder.path().join(name), 7, |_| {}).unwrap();
        Session::open(folder.path().join(name)).unwrap()
    };
    let config = CalibrateConfig { rank: Some(10), ..CalibrateConfig::default() };
    let instrument = calibrate(&measure("calibration", &[]), &config, || {}).unwrap().instrument;
    // A corner of each map, relative to its median; what no pixel with light can have is dead.
    let corner = |file: &str| {
        let whole = FrameReader::open(&data.join(file)).unwrap().read(0).unwrap();
        let map = whole.slice_move(ndarray::s![..98, ..98]);
        let mut sorted: Vec<f32> = map.iter().copied().collect();
        sorted.sort_by(f32::total_cmp);
        (sorted[sorted.len() / 2], map)
    };
    let (gain, gains) = corner("acsn_gain_256.tif");
    let (offset, offsets) = corner("acsn_offset_256.tif");
    let with = |id: &str, table| EffectSetting { table: Some(table), ..EffectSetting::new(id, &[]) };
    let session = measure(
        "session",
        &[with("prnu", gains.mapv(|g| (g / gain - 1.0).clamp(-1.0, 1.0))), with("dsnu", offsets.mapv(|o| o - offset))],
    );
    let mut seen = Observations::read(&session, &Budget::default()).unwrap();
    let closing = close(
        &instrument,
        &mut seen,
        &CloseOptions { session_name: "maps", seed: 1, ..CloseOptions::default() },
        |_| (),
    )
    .unwrap()
    .account
    .closing;
    let named: Vec<&str> = closing.effects.iter().map(|e| e.id.as_str()).collect();
    // What is left of the maps is their slow part, which no pixel has of its own.
    assert_eq!(named[..2], ["dsnu", "prnu"], "{named:?}");
    let excess = (closing.after.chi2_ndf - 1.0) / (closing.before.chi2_ndf - 1.0);
    assert!(excess < 0.02, "{:?} {:?}", closing.before, closing.after);
}

/// Gain and read noise of every pixel of a real sensor, of which some are far worse than the others: darks and flats
/// drawn with them give the gain back within its interval, and the read noise of each pixel, without which a dark frame
/// has outliers that no common noise explains.
#[test]
fn measured_noise_of_pixels_comes_back_from_darks_and_flats() {
    use ommatidia_physics::noise::draw_electrons;
    use ommatidia_session::rng;
    use ommatidia_session::{
        Existing, FrameInfo, FrameReader, Manifest, SampleType, SessionWriter, StackEntry, StackSpec,
    };
    let Some(data) = measured_data("measured_noise_of_pixels_comes_back_from_darks_and_flats", "scmos_maps") else {
        return;
    };
    const SIDE: usize = 200;
    let map = |file: &str| {
        let whole = FrameReader::open(&data.join(file)).unwrap().read(0).unwrap();
        whole.slice_move(ndarray::s![..SIDE, ..SIDE])
    };
    let (gain, read_dn2) = (map("gain_adu_per_e_512.tif"), map("variance_adu2_512.tif"));
    // A few of the fits that made the map failed: no pixel has a gain below zero.
    let gain = gain.mapv(|g| if g > 0.5 { g } else { 2.18 });
    let manifest = format!(
        "format = 1\nname = \"maps\"\nstack = []\n\
        [sensor]\nrows = {SIDE}\ncols = {SIDE}\npixel_pitch_um = 1.0\nbit_depth = 16\n\
        [array]\nrows = 1\ncols = 1\npitch_px = 0.0\n[optics]\nmagnification = 1.0\npsf_window_px = 15\n\
        [object]\nrows = {SIDE}\ncols = {SIDE}\npixel_um = 1.0\n"
    );
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("session");
    let manifest = Manifest::parse(&target, &manifest).unwrap();
    let frame = |what: &str, i: usize, electrons: f32| {
        let mut rng = rng::stream(9, what, i as u64);
        let mut charge = vec![electrons; SIDE * SIDE];
        draw_electrons(&mut charge, 0.0, &mut rng);
        let mut reading = vec![0.0; SIDE * SIDE];
        draw_electrons(&mut reading, 1.0, &mut rng);
        let pixel = |(r, c)| {
            let p = r * SIDE + c;
            (100.0 + gain[[r, c]] * charge[p] + read_dn2[[r, c]].sqrt() * reading[p]).round().clamp(0.0, 65_535.0)
        };
        ndarray::Array2::from_shape_fn((SIDE, SIDE), pixel)
    };
    let mut writer = SessionWriter::create(&target, &manifest, Existing::Keep).unwrap();
    let levels = [300.0, 1000.0, 3000.0, 8000.0];
    for (role, name, count) in [(Role::Dark, "dark", 32), (Role::Flat, "flat", 32)] {
        let spec = StackSpec { frames: count, rows: SIDE, cols: SIDE, samples: SampleType::U16, pixel_um: None };
        let mut frames = writer.frames(&format!("{name}.npy"), spec).unwrap();
        let light = |i: usize| if role == Role::Dark { 0.0 } else { levels[i / 8] };
        (0..count).for_each(|i| frames.push(frame(name, i, light(i)).view()).unwrap());
        frames.finish().unwrap();
        let info = |i| FrameInfo { illumination: f64::from(light(i)).max(1.0), ..FrameInfo::plain(i, 10.0) };
        writer.table(&format!("{name}.csv"), &(0..count).map(info).collect::<Vec<_>>()).unwrap();
        let (file, table) = (format!("{name}.npy"), Some(format!("{name}.csv")));
        writer.add(StackEntry { table, ..StackEntry::plain(role, file, 10.0) });
    }
    writer.finish().unwrap();
    let i = calibrate(&Session::open(&target).unwrap(), &CalibrateConfig::default(), || {}).unwrap().instrument;
    let quantile = |values: &ndarray::Array2<f32>, q: f64| {
        let mut sorted: Vec<f32> = values.iter().copied().collect();
        sorted.sort_by(f32::total_cmp);
        f64::from(sorted[((sorted.len() - 1) as f64 * q) as usize])
    };
    let mean_gain = f64::from(gain.mean().unwrap());
    let off = (i.noise.gain_dn_per_e - mean_gain).abs();
    assert!(off < 4.0 * i.noise.gain_sigma && i.noise.gain_sigma < 0.005 * mean_gain, "{:?} {mean_gain}", i.noise);
    let found = i.reading_dn2.unwrap();
    // A pixel's variance is known to a few tens of per cent, and the map holds what to expect: in each tenth of the
    // pixels by the map, from the quietest to the noisiest, the true variance has its mean. In DN rms.
    let mut pixels: Vec<(f64, f64)> =
        found.iter().zip(&read_dn2).map(|(v, t)| (f64::from(*v), f64::from(*t) + 1.0 / 12.0)).collect();
    pixels.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (i, tenth) in pixels.chunks(pixels.len() / 10).enumerate() {
        let (v, t) = tenth.iter().fold((0.0, 0.0), |(v, t), p| (v + p.0, t + p.1));
        let ratio = (v / t).sqrt();
        assert!((ratio - 1.0).abs() < 0.04, "tenth {i}: {ratio}");
    }
    // And of the worst in a hundred.
    let worst = |values: &ndarray::Array2<f32>| quantile(values, 0.99);
    let ratio = (worst(&found) / worst(&read_dn2)).sqrt();
    assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
    // A dark that nothing has seen, in standard deviations: by pixel, and by the common noise.
    let dark = frame("another", 0, 0.0) - 100.0;
    let offset = i.offset_dn.unwrap();
    let common = i.noise.variance_dn2(i.noise.black_level_dn);
    let beyond = |variance: &dyn Fn((usize, usize)) -> f64| {
        let z = |(at, v): ((usize, usize), &f32)| (f64::from(*v) - f64::from(offset[at])).powi(2) / variance(at);
        dark.indexed_iter().filter(|pixel| z(*pixel) > 16.0).count()
    };
    let (by_pixel, by_all) = (beyond(&|at| f64::from(found[at])), beyond(&|_| common));
    // Four standard deviations: 2.5 of 40,000 by chance, a few more since each pixel's variance is of 32 frames.
    assert!(by_pixel < 40 && by_all > 10 * by_pixel, "{by_pixel} {by_all}");
}

/// A water bear under a miniscope whose colour mosaic nobody declared. Without optics, darks or truth only what is
/// fixed to the sensor can be distinguished from the specimen: the loop finds the mosaic in half of the blocks of
/// the frame, and nothing else, and takes it out of the others.
#[test]
fn measured_mosaic_is_found_and_removed() {
    use ommatidia_closing::{Budget, CloseOptions, Observations, close};
    let Some(folder) = measured_data("measured_mosaic_is_found_and_removed", "sessions/tardigrade") else { return };
    let session = Session::open(&folder).unwrap();
    let instrument = calibrate(&session, &CalibrateConfig::default(), || {}).unwrap().instrument;
    let mut seen = Observations::read(&session, &Budget::default()).unwrap();
    let closed = close(
        &instrument,
        &mut seen,
        &CloseOptions { session_name: "water bear", seed: 1, ..CloseOptions::default() },
        |_| (),
    )
    .unwrap();
    let effects = &closed.account.closing.effects;
    assert!(effects.len() == 1 && effects[0].id == "pixel_mosaic", "{effects:?}");
    let gain = |name: &str| effects[0].params.iter().find(|p| p.name == name).unwrap().value;
    let (checker, rows, cols) = (gain("checker"), gain("rows"), gain("cols"));
    // Checkerboard of the lit part of the blocks that no fit has seen, DN, before and after: of 6 x 6 every second.
    let frame = session.stacks()[0].frames().unwrap().read(0).unwrap();
    let sign = |n: usize| if n.is_multiple_of(2) { 1.0 } else { -1.0 };
    let corrected = ndarray::Array2::from_shape_fn(frame.dim(), |(r, c)| {
        let gain = 1.0 + checker * sign(r + c) + rows * sign(r) + cols * sign(c);
        (f64::from(frame[[r, c]]) / gain) as f32
    });
    let (height, width) = frame.dim();
    let block = |at: usize, of: usize| (6 * (at + 1) - 1) / of;
    let amplitude = |image: &ndarray::Array2<f32>| {
        let (mut sum, mut n) = (0.0, 0.0);
        for (i, cell) in image.exact_chunks((2, 2)).into_iter().enumerate() {
            let (row, col) = (2 * (i / (width / 2)), 2 * (i % (width / 2)));
            let held_out = (block(row, height) + block(col, width)) % 2 == 1;
            if held_out && cell.iter().all(|v| *v > 40.0) {
                let d = |a: usize, b: usize| f64::from(cell[[a, b]]);
                sum += (d(0, 0) - d(0, 1) - d(1, 0) + d(1, 1)) / 4.0;
                n += 1.0;
            }
        }
        sum / n
    };
    let (before, after) = (amplitude(&frame), amplitude(&corrected));
    assert!(before > 1.5 && after.abs() < 0.03, "{before} {after}");
}

/// A video of a wireless miniscope whose rows are each read with an offset of their own, new in every frame; a tenth of
/// its frames were torn on their way. Nobody knows the specimen, but it is nearly the same from one frame to the next.
#[test]
fn measured_row_noise_of_a_video_is_named() {
    use ommatidia_closing::{Budget, CloseOptions, Observations, close};
    let Some(folder) = measured_data("measured_row_noise_of_a_video_is_named", "miniscope") else { return };
    let target = tempfile::tempdir().unwrap();
    std::fs::copy(folder.join("mio_wireless_60x200x200.tif"), target.path().join("scene.tif")).unwrap();
    let manifest = "format = 1\nname = \"video\"\n\
        [sensor]\nrows = 200\ncols = 200\npixel_pitch_um = 1.0\nbit_depth = 8\n\
        [array]\nrows = 1\ncols = 1\npitch_px = 0.0\n\
        [optics]\nmagnification = 1.0\npsf_window_px = 15\n\
        [object]\nrows = 200\ncols = 200\npixel_um = 1.0\n\
        [[stack]]\nrole = \"scene\"\nfile = \"scene.tif\"\nexposure_ms = 1.0\n";
    std::fs::write(target.path().join("session.toml"), manifest).unwrap();
    let session = Session::open(target.path()).unwrap();
    let instrument = calibrate(&session, &CalibrateConfig::default(), || {}).unwrap().instrument;
    let mut seen = Observations::read(&session, &Budget::default()).unwrap();
    let closed = close(
        &instrument,
        &mut seen,
        &CloseOptions { session_name: "video", seed: 1, ..CloseOptions::default() },
        |_| (),
    )
    .unwrap();
    let first = &closed.account.closing.effects[0];
    let sigma = first.params[0].value;
    // By hand: scatter of the rows' means in the difference of two frames, which has twice the variance of one, about
    // the mean of the 17 rows around each; the middle of all pairs of frames.
    let mut frames = session.stacks()[0].frames().unwrap();
    let means: Vec<Vec<f64>> =
        (0..60).map(|i| frames.read(i).unwrap().outer_iter().map(|r| f64::from(r.mean().unwrap())).collect()).collect();
    let mut scatter: Vec<f64> = means
        .windows(2)
        .map(|w| {
            let d: Vec<f64> = w[1].iter().zip(&w[0]).map(|(b, a)| b - a).collect();
            let off = d.windows(17).map(|w| (w[8] - w.iter().sum::<f64>() / 17.0).powi(2));
            (off.sum::<f64>() / (2.0 * (1.0 - 1.0 / 17.0) * (d.len() - 16) as f64)).sqrt()
        })
        .collect();
    scatter.sort_by(f64::total_cmp);
    let by_hand = scatter[scatter.len() / 2];
    assert!(first.id == "row_noise" && (sigma / by_hand - 1.0).abs() < 0.25, "{} {sigma}, by hand {by_hand}", first.id);
}
