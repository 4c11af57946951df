//! Where float networks are computed.

use super::TrainError;
use super::network::Mode;
use burn::tensor::Device;

/// Where float networks are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Place {
    /// On this machine's cores; the same bits in every run.
    #[default]
    Cpu,
    /// On a graphics card, through Vulkan, Metal or DirectX: in a program built with `--features gpu`. Sums there have no fixed order.
    Gpu,
}

impl Place {
    /// Whether this program can compute there.
    ///
    /// # Errors
    /// It was built without what that takes.
    pub fn check(self) -> Result<(), TrainError> {
        if self == Self::Gpu && !cfg!(feature = "gpu") {
            return Err(TrainError::Config {
                field: "device",
                expected: "cpu, or a program built with `cargo build --release -p ommatidia-host --features gpu`"
                    .into(),
                found: "gpu".into(),
            });
        }
        Ok(())
    }

    pub(super) fn device(self, mode: Mode) -> Device {
        let device = match self {
            #[cfg(feature = "gpu")]
            Self::Gpu => Device::wgpu(burn::tensor::DeviceKind::DefaultDevice),
            _ => Device::flex(),
        };
        match mode {
            Mode::Train => device.autodiff(),
            Mode::Infer => device,
        }
    }
}
