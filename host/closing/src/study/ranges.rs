//! Physical ranges: the strength beyond which an effect is no longer what its name says, and a study does not go.

/// Largest absolute value of the first strength of an effect, in its unit; `None`: the range of its descriptor.
///
/// Displacements end at half a window, turns at 2 degrees, changes of size at 5 %, blurs at 3 px, and light at a factor
/// of about 3; defocus at two thirds of the depth of the bead scan (an instrument knows no PSF beyond). What acts on
/// single pixels, rows or electronics ends where a person would see it in one frame.
pub fn largest(id: &str) -> Option<f64> {
    Some(match id {
        // Pixels, px^2 and mrad.
        "array_shift" | "array_jump" => 7.0,
        "lens_decentre" => 3.0,
        "array_rotation" => 35.0,
        "motion_blur" => 9.0,
        "charge_diffusion" => 2.0,
        "rank_truncation" => 4.0,
        // px/s, over half a second of a session.
        "thermal_drift" => 8.0,
        // Relative changes of size.
        "magnification" | "stage_scale" => 0.05,
        // A tenth of the wavelength: the width of an emission filter.
        "spectral_shift" => 0.1,
        // mm^-2 and um/mm^2, at 0.05 mm from the axis.
        "radial_distortion" => 20.0,
        "field_curvature" => 16_000.0,
        "defocus" => 40.0,
        // um/mm: half a radian.
        "tilt" => 500.0,
        // um of the stage, 7 px of the image.
        "stage_backlash" => 20.0,
        // mm^-2: half of the light at 0.15 mm from the axis.
        "chief_ray_response" => 22.0,
        // Relative changes of light.
        "vignetting" | "excitation_profile" | "lens_gain" => 0.7,
        "halo" => 0.5,
        "camera_processing" => 1.0,
        "lag" | "readout_lag" | "flicker_banding" | "lens_leakage" | "pixel_mosaic" => 0.3,
        "veiling_glare" | "ghost" | "nonlinearity" => 0.2,
        "interpixel_capacitance" => 0.06,
        "prnu" => 0.2,
        "dust" => 0.8,
        // 1/s, over half a second of a session.
        "photobleaching" | "lamp_drift" => 2.0,
        // ms, of 5 or 10.
        "exposure_offset" => 3.0,
        // e-/px/ms and DN, below half of full scale.
        "background" | "dark_current" => 100.0,
        "row_pattern" | "column_pattern" | "dsnu" | "adc_nonlinearity" => 150.0,
        "row_noise" => 50.0,
        "telegraph_pixels" => 150.0,
        "black_level_drift" => 500.0,
        "noise_scale" => 3.0,
        _ => return None,
    })
}
