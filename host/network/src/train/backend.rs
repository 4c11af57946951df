//! Where float networks are computed, and whether gradients are recorded.

use super::TrainError;
use burn_tensor::Device;

/// Whether gradients are recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Gradients are recorded, for training.
    Train,
    /// Gradients are not recorded, for inference.
    Infer,
}

/// Where float networks are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Backend {
    /// On the CPU of this machine; every run gives the same bits.
    #[default]
    Cpu,
    /// On a graphics card, through Vulkan, Metal or DirectX, in a program built with `--features gpu`. The order of
    /// sums is not fixed there, so bits can differ from run to run.
    Gpu,
}

impl Backend {
    /// Checks that this program was built with the backend, and that this machine has it.
    ///
    /// # Errors
    /// [`TrainError::Config`]: the program was built without it, or no graphics card is to be found.
    pub fn check(self) -> Result<(), TrainError> {
        if self == Self::Gpu && !cfg!(feature = "gpu") {
            return Err(TrainError::Config {
                field: "device",
                expected: "cpu, or a program built with `cargo build --release -p ommatidia --features gpu`".into(),
                found: "gpu".into(),
            });
        }
        #[cfg(feature = "gpu")]
        if self == Self::Gpu && !has_card() {
            return Err(TrainError::Config {
                field: "device",
                expected: "cpu, or a graphics card with its driver and Vulkan, Metal or DirectX (on Linux \
                           libvulkan.so.1 and the driver's file in /usr/share/vulkan/icd.d)"
                    .into(),
                found: "gpu, and no graphics card".into(),
            });
        }
        Ok(())
    }

    pub(super) fn device(self, mode: Mode) -> Device {
        let device = match self {
            #[cfg(feature = "gpu")]
            Self::Gpu => Device::wgpu(burn_tensor::DeviceKind::DefaultDevice),
            _ => Device::flex(),
        };
        match mode {
            Mode::Train => device.autodiff(),
            Mode::Infer => device,
        }
    }
}

/// Whether a graphics card is to be found. Burn panics where there is none.
#[cfg(feature = "gpu")]
fn has_card() -> bool {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    !futures_lite::future::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY)).is_empty()
}
