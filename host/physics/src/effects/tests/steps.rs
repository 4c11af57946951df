//! Steps of parameters against a typical frame, and the page that lists all effects.

use super::*;

/// A typical frame: the light of each lens, with spots of 1.6 px rms and 7000 electrons at the brightest, and the
/// anchors.
fn typical() -> (Vec<Array2<f32>>, Vec<[f64; 2]>) {
    let anchors: Vec<[f64; 2]> =
        (0..9).map(|l| [106.5 + 50.0 * (l / 3) as f64 - 50.0, 106.5 + 50.0 * (l % 3) as f64 - 50.0]).collect();
    let mut object = Array2::<f32>::zeros((97, 97));
    for i in 0..160usize {
        let at = [(i * 7919) % 89 + 4, (i * 104_729) % 89 + 4];
        object[at] += 1.0 + (i % 7) as f32;
    }
    let mut object = smooth::gaussian_blur(&object, 1.6);
    object += 0.02;
    let place = |anchor: &[f64; 2]| {
        let mut image = Array2::<f32>::zeros((214, 214));
        let corner = anchor.map(|a| a.round() as usize - 48);
        image.slice_mut(ndarray::s![corner[0]..corner[0] + 97, corner[1]..corner[1] + 97]).assign(&object);
        image
    };
    let mut lenses: Vec<_> = anchors.iter().map(place).collect();
    let peak = lenses.iter().fold(Array2::<f32>::zeros((214, 214)), |s, i| s + i).fold(0.0f32, |m, v| m.max(*v));
    lenses.iter_mut().for_each(|i| *i *= 7000.0 / peak);
    (lenses, anchors)
}

#[test]
fn steps_are_a_few_sigma_of_one_typical_frame() {
    let (lenses, anchors) = typical();
    let sum: Array2<f32> = lenses.iter().fold(Array2::zeros((214, 214)), |s, i| s + i);
    let previous = sum.slice(ndarray::s![..;-1, ..]).to_owned();
    let axes: Vec<[f64; 2]> = anchors.iter().map(|a| a.map(|a| 106.5 + 0.6 * (a - 106.5))).collect();
    let cx = FrameContext {
        frame: 1,
        time_s: 0.1,
        exposure_ms: 10.0,
        anchors_px: &anchors,
        axes_px: &axes,
        pixel_pitch_um: 1.85,
        travel: [1.0, -1.0],
        full_scale_e: 1e4,
        black_level_dn: 64.0,
        gain_dn_per_e: 0.4,
        previous: Some(Previous { light_e: &previous, interval_s: 0.02 }),
        ..Default::default()
    };
    let layout = Layout { lenses: 9, sensor: [214, 214] };
    let frame = |chain: &Chain| {
        let mut light = Array2::<f32>::zeros((214, 214));
        for (lens, image) in lenses.iter().enumerate() {
            let cx = FrameContext { lens, ..cx };
            let mut image = image.clone();
            chain.on_object(&mut image, &cx);
            if chain.acts_at(Stage::Geometry) {
                let from = image.clone();
                for r in 1..213 {
                    for c in 1..213 {
                        let field = [r as f64 - anchors[lens][0], c as f64 - anchors[lens][1]];
                        let anchor = anchors[lens].map(|a| a - 106.5);
                        let axis = [0, 1].map(|a| field[a] + anchor[a] * 0.4);
                        let ray = Ray {
                            lens,
                            object_um: field.map(|v| v * 2.8),
                            field_px: field,
                            axis_px: axis,
                            anchor_px: anchor,
                            pixel_pitch_um: 1.85,
                            px_per_um: 1.0 / 2.8,
                        };
                        let s = chain.shift_ray(&ray, &cx);
                        // Defocus of 100 um widens a spot by about a tenth of a pixel squared.
                        // PSFs of a variance of 2 px^2 that grow by a share become wider by four times as much.
                        // Astigmatism and spherical aberration widen spots that have a tenth of a wave of it already:
                        // the mean of |grad Z|^2 is 12 for astigmatism, and about as much for the part of coma that
                        // does not displace.
                        let added: f64 = chain.wavefront(&ray, &cx).coefficient[4..].iter().sum();
                        let wide = 0.5e-3 * s.z_um + 2.0 * s.growth + 12.0 * added;
                        let px = s.px.map(|v| v as f32);
                        let d = [from[[r + 1, c]] - from[[r - 1, c]], from[[r, c + 1]] - from[[r, c - 1]]];
                        let curve = from[[r + 1, c]] + from[[r - 1, c]] + from[[r, c + 1]] + from[[r, c - 1]]
                            - 4.0 * from[[r, c]];
                        image[[r, c]] -= 0.5 * (px[0] * d[0] + px[1] * d[1]) - wide as f32 * curve;
                    }
                }
            }
            chain.on_lens(&mut image, &cx);
            light += &image;
        }
        chain.on_light(&mut light, &cx);
        chain.on_charge(&mut light, &cx);
        let mut dn = light * 0.4 + 64.0;
        chain.on_electronics(&mut dn, &cx);
        dn
    };
    let plain = frame(&Chain::default());
    let variance = plain.mapv(|v| 0.4 * (v - 64.0) + 0.64 + 1.0 / 12.0);
    let named = registry().iter().filter(|e| !e.descriptor().id.starts_with("unknown"));
    for effect in named.filter(|e| !e.noise_only() && e.descriptor().stage != Stage::Record) {
        let d = effect.descriptor();
        let off: Vec<f64> = d.expanded(9).iter().map(|(_, p)| p.off).collect();
        for (i, (name, p)) in d.expanded(9).into_iter().enumerate().filter(|(_, (_, p))| p.is_strength()) {
            // One lens is tested for all.
            if p.per_lens && !name.ends_with("_4") {
                continue;
            }
            let mut on = off.clone();
            on[i] += p.step;
            let mut chain = Chain::default();
            chain.push(*effect, on, None, layout).unwrap();
            let chi2 = (frame(&chain) - &plain).mapv(|d| d * d) / &variance;
            let sigma = chi2.sum().sqrt();
            println!("{} {name} {}: {sigma:.1} sigma", d.id, p.step);
            assert!((1.0..50.0).contains(&sigma), "{} {name}: {sigma} sigma", d.id);
        }
    }
}

/// The page that lists all effects.
fn page() -> String {
    let mut text = String::from(PAGE_HEAD);
    for stage in Stage::ALL {
        text += &format!(
            "\n## Stage `{}`\n\n| id | formula | parameters | looks like: what distinguishes them |\n{}\n",
            format!("{stage:?}").to_lowercase(),
            "|---|---|---|---|"
        );
        for d in registry().iter().map(|e| e.descriptor()).filter(|d| d.stage == stage) {
            let params: Vec<String> = d.params.iter().map(parameter).collect();
            let others: Vec<String> = d.lookalikes.iter().map(|l| format!("`{}`: {}", l.id, l.separate_by)).collect();
            text += &format!("| `{}` | {} | {} | {} |\n", d.id, d.summary, params.join("; "), others.join("; "));
        }
    }
    text
}

fn parameter(p: &Param) -> String {
    let unit = if p.unit == "1" { String::new() } else { format!(", {}", p.unit) };
    let each = if p.per_lens { " of each lens" } else { "" };
    match p.kind {
        Kind::Strength | Kind::Square if p.off == 0.0 => format!("**{}**{each}{unit}", p.name),
        Kind::Strength | Kind::Square => format!("**{}**{each}{unit} (absent: {})", p.name, p.off),
        Kind::Shape(_) | Kind::Choice => format!("{}{each}{unit} (default {})", p.name, p.off),
    }
}

const PAGE_HEAD: &str = "# Effects

Effects of real instruments beyond their calibrated optics, in the order in which they act on the light. Each effect has
one definition in `host/physics/src/effects/`, with a longer description. The forward model applies it, `close` fits it,
and the virtual bench injects it: `ommatidia bench session --effect halo=0.05,sigma_px=20` sets the first parameter, and
others by name.

**Strengths** are in bold: with all of them at zero (or at the stated value) the effect is absent, to the last bit. The
other parameters are shapes and choices. This page is generated from the descriptors, and a test compares the two:
`OMMATIDIA_RENEW=1 cargo test -p ommatidia-physics --lib effects` writes the page again.

**Places and units.** A frame is `mu`, electrons a pixel before the noise, and `y`, DN, after it; `mu_l` is the part of
lens l. The **axis** of a lens runs through the lens, perpendicular to the array. It meets the sensor beside the anchor
(the chief ray of a source in the middle of the object): nearer to the middle of the array, by the anchor's distance
from there over 1 + 1 / magnification. Lengths in mm are of the sensor where they are measured from such an axis
(`radial_distortion`, `field_curvature`, `chief_ray_response`, `aberration_drift`), and of the object where they are
measured from its centre (`object_distortion`, `tilt`). `r` of `vignetting` and `rho` of `excitation_profile` are 1 in
the corners of the sensor and of the object. The centre of a `ghost` is counted from the middle of the sensor.
Neighbours of a pixel or of a lens are those above, below, left and right; a lens that leaks loses no light. Full scale
is the charge at which frames saturate, above the black level, e-. Light that a `halo` scatters off the sensor is lost,
and none comes from beyond it, for a `ghost` either. Flats, which are lit from there as well, show neither. The mean of
`veiling_glare` is that over the sensor. In `background`, t is the exposure in ms, P the light level of the frame
(`illumination` of the session), and s runs from -1 to 1 over the sensor; flats have it too. A depth changes the shape
of the PSFs, and moves no focus: `z_um` of a `defocus` adds to the recorded depth, with the sign of `z_um` in the table
of the beads. `spectral_shift` scales the PSF at the same wavefront in waves; a real wavelength changes the wavefront
in waves too. The smooth part of flats belongs to their lamp, so flats show neither `vignetting` nor
`chief_ray_response`. Where an instrument has an effect already, such as the bend of its sensor (`nonlinearity`), the
account gives its value in this session, and not the change.
";

#[test]
fn the_page_of_effects_is_what_the_registry_says() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/effects.md");
    if std::env::var_os("OMMATIDIA_RENEW").is_some() {
        std::fs::write(&path, page()).unwrap();
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(found == page(), "docs/effects.md is out of date: run this test with OMMATIDIA_RENEW=1");
}
