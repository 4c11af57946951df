//! The bend of a sensor's response: the signal of a pixel is `m = L - beta L^2 / F`. L is the light that it would show
//! if it were linear and F the full scale, both in DN above black.

/// The bend of a response: `m = L - beta L^2 / F`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bend {
    /// Shortfall at full scale, relative.
    pub beta: f64,
    /// Its standard error.
    pub sigma: f64,
    /// Full scale above the black level, DN.
    pub full_scale_dn: f64,
}

impl Bend {
    /// The light L of a linear pixel, DN above black, for the signal `signal_dn` above black.
    ///
    /// ```
    /// use ommatidia_physics::noise::Bend;
    /// let bend = Bend { beta: 0.02, sigma: 0.001, full_scale_dn: 4000.0 };
    /// // 2000 DN are read as 2000 - 0.02 * 2000^2 / 4000 = 1980 DN.
    /// assert!((bend.straight(1980.0) - 2000.0).abs() < 1e-9);
    /// ```
    pub fn straight(&self, signal_dn: f64) -> f64 {
        2.0 * signal_dn / (1.0 + (1.0 - 4.0 * self.beta / self.full_scale_dn * signal_dn).max(0.0).sqrt())
    }

    /// The derivative dm/dL at the light `light_dn`.
    pub(super) fn slope(&self, light_dn: f64) -> f64 {
        1.0 - 2.0 * self.beta * light_dn / self.full_scale_dn
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FULL_DN: f64 = 4000.0;

    #[test]
    fn straightened_signals_are_the_light() {
        for beta in [-0.1, 0.0, 0.05] {
            let bend = Bend { beta, sigma: 0.0, full_scale_dn: FULL_DN };
            for light in [-20.0, 0.0, 700.0, 3900.0] {
                let signal = light - beta * light * light / FULL_DN;
                assert!((bend.straight(signal) - light).abs() < 1e-9 * (1.0 + light.abs()));
            }
        }
    }
}
