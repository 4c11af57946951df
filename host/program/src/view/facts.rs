//! The main figures of a file, for the head of its page.

use ommatidia_closing::Closing;
use ommatidia_network::evaluate::Summary;
use ommatidia_network::methods::title;
use ommatidia_network::uncertainty::Made;
use ommatidia_report::number;
use ommatidia_session::Manifest;
use serde_json::Value;

/// Names and values.
pub type Facts = Vec<[String; 2]>;

fn fact(name: &str, value: impl Into<String>) -> [String; 2] {
    [name.into(), value.into()]
}

/// Sensor, array, object.
pub fn of_manifest(m: &Manifest) -> Facts {
    let (s, a, o) = (&m.sensor, &m.array, &m.object);
    vec![
        fact("name", m.name.clone()),
        fact(
            "sensor",
            format!("{} × {} pixels of {} um, {} bit", s.rows, s.cols, number(s.pixel_pitch_um), s.bit_depth),
        ),
        fact(
            "lenses",
            match a.lenses_px {
                None => format!("{} × {}", a.rows, a.cols),
                Some(_) => a.lenses().to_string(),
            },
        ),
        fact("object", format!("{} × {} pixels of {} um", o.rows, o.cols, number(o.pixel_um))),
        fact("magnification", number(m.optics.magnification)),
    ]
}

/// An instrument; `body` is that of its header.
pub fn of_instrument(m: &Manifest, body: &Value) -> Facts {
    let mut facts = of_manifest(m);
    let mut add = |name: &str, value: &Value, unit: &str| {
        if let Some(value) = value.as_f64() {
            facts.push(fact(name, format!("{} {unit}", number(value)).trim_end()));
        }
    };
    let (noise, quality) = (&body["noise"], &body["quality"]);
    add("black level", &noise["black_level_dn"], "DN");
    add("gain", &noise["gain_dn_per_e"], "DN/e-");
    add("read noise", &noise["read_noise_e"], "e-");
    add("NRMSE on the scan", &quality["approximation_error"], "");
    add("NRMSE on held-out positions", &quality["off_grid_error"], "");
    let effects = body["effects"].as_array().into_iter().flatten().filter_map(|e| e["id"].as_str());
    let effects: Vec<&str> = effects.collect();
    if !effects.is_empty() {
        facts.push(fact("effects", effects.join(", ")));
    }
    facts
}

/// An evaluation: its methods.
pub fn of_evaluation(s: &Summary) -> Facts {
    let mut facts = vec![fact("session", s.session.clone()), fact("frames compared", s.frames.to_string())];
    facts.extend(s.methods.iter().map(|m| fact(&title(&m.name), format!("{:.2} dB, SSIM {:.3}", m.psnr_db, m.ssim))));
    facts
}

/// An account: verdict, figures before and after, effects.
pub fn of_closing(c: &Closing) -> Facts {
    let mut facts = vec![
        fact("session", c.session.clone()),
        fact("chi-squared a pixel", format!("{:.4} before, {:.4} after", c.before.chi2_ndf, c.after.chi2_ndf)),
        fact("verdict", c.verdict.words()),
    ];
    facts.extend(c.effects.iter().map(|e| fact(&e.id, format!("{:.1} sigma: {}", e.z, e.description))));
    facts
}

/// A network: its sizes.
pub fn of_network(frame: Option<[usize; 2]>, object: Option<[usize; 2]>) -> Facts {
    let size = |name: &str, size: Option<[usize; 2]>| size.map(|[r, c]| fact(name, format!("{r} × {c} pixels")));
    size("frame", frame).into_iter().chain(size("object", object)).collect()
}

/// Widths: what they were learned from.
pub fn of_widths(m: &Made) -> Facts {
    vec![
        fact("method", title(&m.method)),
        fact("coverage", number(m.coverage)),
        fact("scenes", format!("{} for the scale, {} for conformal calibration", m.scale_scenes, m.scenes)),
        fact("limits of a frame", format!("from the {} scenes most like it", m.neighbours)),
        fact("object", format!("{} × {} pixels", m.object[0], m.object[1])),
        fact("brightest pixel", format!("{} to {} e-", number(m.peak_e[0]), number(m.peak_e[1]))),
    ]
}
