//! Networks and their peers: training, quantization, reconstruction, evaluation. The only package that knows burn.
//!
//! | module | contents |
//! |---|---|
//! | [`train`] | SV-FourierNet and the networks beside it: losses, schedule, training loop, checkpoint |
//! | [`methods`] | from a frame to an object: networks, network files, Wiener, Richardson-Lucy, ADMM, central lens |
//! | [`quantize`] | checkpoint -> network file in half precision, with its memory plan |
//! | [`network_file`] | network files on the host |
//! | [`uncertainty`] | intervals for each pixel of a reconstruction, calibrated and checked |
//! | [`watch`] | maps with which a device notices that its optics have moved |
//! | [`evaluate`] | methods side by side; spectra by radius, resolution by position, receptive fields |

pub mod evaluate;
pub mod methods;
pub mod network_file;
pub mod quantize;
pub mod train;
pub mod uncertainty;
pub mod watch;
