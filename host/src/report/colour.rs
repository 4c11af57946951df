//! Colours: perceptually uniform maps for pictures.

use colorous::Gradient;

/// A colour map. Inferno and viridis are perceptually uniform: equal steps of signal look equal everywhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourMap {
    /// Black, violet, red, yellow, white: light.
    Inferno,
    /// Violet, green, yellow: maps of a figure between 0 and 1.
    Viridis,
    /// Black to white: raw frames.
    Grey,
    /// Blue, white, red: signed values, zero white. Non-finite values are [`ABSENT`].
    Diverging,
}

/// Colour of a pixel without a value.
pub const ABSENT: [u8; 3] = [150, 154, 158];
/// Its index in the palette of [`ColourMap::Diverging`]. The 255 levels before it are an odd number, so zero has its
/// own.
pub const ABSENT_LEVEL: u8 = 255;

impl ColourMap {
    /// Red, green, blue at `t` in 0..=1.
    pub fn at(self, t: f64) -> [u8; 3] {
        let gradient: Gradient = match self {
            Self::Inferno => colorous::INFERNO,
            Self::Viridis => colorous::VIRIDIS,
            Self::Grey => {
                let level = (255.0 * t.clamp(0.0, 1.0)).round() as u8;
                return [level; 3];
            }
            Self::Diverging => {
                let c = colorous::RED_BLUE.eval_continuous(1.0 - t.clamp(0.0, 1.0));
                return [c.r, c.g, c.b];
            }
        };
        let colour = gradient.eval_continuous(t.clamp(0.0, 1.0));
        [colour.r, colour.g, colour.b]
    }

    /// The 256 colours of an 8-bit picture.
    pub fn palette(self) -> Vec<u8> {
        let levels = f64::from(self.levels());
        let absent = (self == Self::Diverging).then_some(ABSENT);
        (0..=self.levels()).map(|i| self.at(f64::from(i) / levels)).chain(absent).flatten().collect()
    }

    /// The highest level of an 8-bit picture.
    pub fn levels(self) -> u8 {
        if self == Self::Diverging { ABSENT_LEVEL - 1 } else { 255 }
    }

    /// A CSS gradient from low (left) to high (right).
    pub fn css(self) -> String {
        let stops: Vec<String> = (0..=16).map(|i| hex(self.at(f64::from(i) / 16.0))).collect();
        format!("linear-gradient(to right,{})", stops.join(","))
    }
}

fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// CIE 1976 lightness L* of an sRGB colour (IEC 61966-2-1 decoding, D65 luminance weights).
    fn lightness(rgb: [u8; 3]) -> f64 {
        let linear = rgb.map(|v| {
            let v = f64::from(v) / 255.0;
            if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
        });
        let y = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
        if y > 216.0 / 24_389.0 { 116.0 * y.cbrt() - 16.0 } else { y * 24_389.0 / 27.0 }
    }

    #[test]
    fn lightness_grows_evenly() {
        for map in [ColourMap::Inferno, ColourMap::Viridis] {
            let l: Vec<f64> = (0..=20).map(|i| lightness(map.at(f64::from(i) / 20.0))).collect();
            let mean = (l[20] - l[0]) / 20.0;
            for pair in l.windows(2) {
                let step = pair[1] - pair[0];
                assert!(step > 0.3 * mean && step < 1.8 * mean, "{map:?}: {step} against {mean}");
            }
        }
    }

    #[test]
    fn ends_and_palette() {
        assert_eq!(ColourMap::Grey.at(1.0), [255; 3]);
        assert_eq!(ColourMap::Grey.at(-3.0), [0; 3]);
        assert_eq!(ColourMap::Inferno.palette().len(), 768);
        let palette = ColourMap::Diverging.palette();
        assert_eq!((palette.len(), &palette[765..]), (768, ABSENT.as_slice()));
        let [blue, zero, red] = [0, 127, 254].map(|i: usize| [palette[3 * i], palette[3 * i + 1], palette[3 * i + 2]]);
        assert!(blue[2] > blue[0] && red[0] > red[2] && zero.iter().all(|v| *v > 230), "{blue:?} {zero:?} {red:?}");
        assert!(ColourMap::Grey.css().starts_with("linear-gradient(to right,#000000,"));
    }
}
