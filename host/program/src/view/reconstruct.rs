//! Reconstructions of a frame by a network among the files, with intervals where there are widths for it.

use super::pixels;
use crate::http::Answer;
use anyhow::{Context, ensure};
use ndarray::Array2;
use ommatidia_model::instrument::Instrument;
use ommatidia_network::methods::{MethodKind, Reconstruct};
use ommatidia_network::uncertainty::{Ready, Widths};
use ommatidia_report::Look;
use ommatidia_session::SampleType;
use ommatidia_session::artifact::file_hash;
use std::path::{Path, PathBuf};

/// Networks that are ready, the last one used last.
#[derive(Default)]
pub struct Networks {
    method: Option<(PathBuf, Box<dyn Reconstruct>)>,
    widths: Option<([PathBuf; 2], Ready)>,
}

impl Networks {
    /// The reconstruction of a frame, DN: float32, [object rows, object cols]; with widths three of them: the
    /// reconstruction, its lower and its upper limits.
    ///
    /// # Errors
    /// The network cannot be read, or the frame does not fit it.
    pub fn reconstruct(
        &mut self,
        network: &Path,
        frame_dn: &Array2<f32>,
        widths: Option<(&Path, &[PathBuf])>,
    ) -> anyhow::Result<Answer> {
        if self.method.as_ref().is_none_or(|(path, _)| path != network) {
            let method = MethodKind::default_for(network)?.open(network, 1)?;
            self.method = Some((network.into(), method));
        }
        let (_, method) = self.method.as_ref().context("no network")?;
        let object = method.reconstruct(frame_dn.view())?;
        let Some((path, instruments)) = widths else {
            return Ok(pixels::picture(&object, SampleType::F32, Look::Light, ""));
        };
        let both = [path.to_path_buf(), network.to_path_buf()];
        if self.widths.as_ref().is_none_or(|(of, _)| *of != both) {
            self.widths = Some((both, ready(path, method.name(), network, instruments)?));
        }
        let (_, ready) = self.widths.as_ref().context("no widths")?;
        let limits = ready.intervals(frame_dn.view(), &object)?;
        let doubt = match (limits.suspicion.inconsistent, limits.suspicion.unlike) {
            (true, _) => "the frame that the reconstruction predicts is unlike the measured one",
            (false, true) => "no scene of the calibration looks like this frame",
            _ => "",
        };
        let all = [&object, &limits.lower, &limits.upper];
        Ok(pixels::pictures(&all, SampleType::F32, Look::Light, doubt))
    }
}

/// Widths with the instrument among the files that they were made for.
fn ready(path: &Path, method: &str, network: &Path, instruments: &[PathBuf]) -> anyhow::Result<Ready> {
    let widths = Widths::read(path)?;
    let own = instruments.iter().find(|i| file_hash(i).is_ok_and(|hash| hash == widths.made.instrument));
    let own = own.context("the instrument that these widths were made for is not among the files: name it, too")?;
    widths.check(path, method, network, own)?;
    let instrument = Instrument::read(own)?;
    ensure!(!instrument.sensor_only(), "the instrument has no optics");
    Ok(widths.on(&instrument)?)
}
