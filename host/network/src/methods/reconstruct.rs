//! What every method does, and what methods are called in tables.

use ndarray::{Array2, ArrayView2};

/// A method that reconstructs an object from one raw frame.
pub trait Reconstruct: Send + Sync {
    /// Name in tables and on the command line.
    fn name(&self) -> &str;
    /// Reconstructs the object, [object rows, object cols], >= 0, from a raw frame, DN, [sensor rows, sensor cols].
    ///
    /// The object's unit depends on the method; figures of merit use one free scale a frame.
    ///
    /// # Errors
    /// The frame has another shape than the sensor, or holds values that the method cannot use.
    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>>;
}

/// Title of a method in tables and figures. A name can carry the file that the method was made from:
/// `wiener@b.safetensors`.
///
/// ```
/// use ommatidia_network::methods::title;
///
/// assert_eq!(title("admm"), "ADMM with TV, all PSFs");
/// assert_eq!(title("central@b.safetensors"), "Central lens alone (b.safetensors)");
/// ```
pub fn title(name: &str) -> String {
    let (method, file) = name.split_once('@').map_or((name, None), |(m, f)| (m, Some(f)));
    let title = match method {
        "svfouriernet" => "SV-FourierNet, float",
        "svfouriernet-blob" => "SV-FourierNet, blob on the host",
        "device" => "SV-FourierNet, device",
        "firmware-on-host" => "SV-FourierNet, not on a device",
        "multiwienernet" => "MultiWienerNet",
        "multiflatnet" => "MultiFlatNet",
        "cm2net" => "CM2Net",
        "wiener" => "Wiener, centre PSF",
        "admm" => "ADMM with TV, all PSFs",
        "admm-lsi" => "ADMM with TV, centre PSF",
        "richardson-lucy" => "Richardson-Lucy, all PSFs",
        "central" => "Central lens alone",
        other => other,
    };
    file.map_or_else(|| title.to_string(), |f| format!("{title} ({f})"))
}
