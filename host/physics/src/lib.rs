//! The physics of a multi-aperture miniscope, without any calibration: optics, light, sensor, and the mathematics that
//! these need.
//!
//! | module | contents |
//! |---|---|
//! | [`fft2`], [`linalg`] | planned two-dimensional real transforms; small dense linear algebra |
//! | [`sensor`] | maps of a sensor's pixels, and the correction of raw frames with them |
//! | [`noise`] | the noise model: measured from darks and flats, drawn for simulations |
//! | [`optics`] | Zernike polynomials, pupil -> PSF, integration over pixels |
//! | [`effects`] | what instruments do beyond their nominal model; one effect a file |
//! | [`scene`] | synthetic specimens |
//!
//! Nothing here knows the low-rank model: the virtual instrument (`ommatidia-bench`) and the calibrated model
//! (`ommatidia-model`) both stand on this package and not on each other.

pub mod effects;
pub mod fft2;
pub mod interpolation;
pub mod linalg;
pub mod noise;
pub mod optics;
pub mod scene;
pub mod sensor;
