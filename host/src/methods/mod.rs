//! Ways from a raw frame to an object: the network, and the methods that it must beat.

mod admm;
mod blob;
mod central;
mod error;
mod frame;
mod network;
mod registry;
mod richardson_lucy;
mod wiener;

pub use admm::{AdmmConfig, LowRankAdmm, ShiftInvariantAdmm};
pub use blob::{Blob, NetworkFileError};
pub use central::Central;
pub use error::MethodError;
pub use frame::FrameCorrection;
pub use network::FloatNetwork;
pub use registry::MethodKind;
pub use richardson_lucy::{RichardsonLucy, RichardsonLucyConfig};
pub use wiener::{Example, Wiener, WienerConfig};

use ndarray::{Array2, ArrayView2};

/// A method that reconstructs an object from one raw frame.
pub trait Reconstruct: Send + Sync {
    /// Name in tables and on the command line.
    fn name(&self) -> &str;
    /// Raw frame, DN, [sensor rows, sensor cols] -> object, [object rows, object cols], >= 0, in a unit of its own
    /// (judged with one free scale a frame).
    ///
    /// # Errors
    /// The frame has the wrong shape or holds values that are no numbers.
    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>>;
}

/// What a method is called in tables and figures. A name may carry the file that it came from: `wiener@b.safetensors`.
pub fn title(name: &str) -> String {
    let (method, file) = name.split_once('@').map_or((name, None), |(m, f)| (m, Some(f)));
    let title = match method {
        "svfouriernet" => "SV-FourierNet, float",
        "svfouriernet-blob" => "SV-FourierNet, blob on the host",
        "device" => "SV-FourierNet, device",
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
