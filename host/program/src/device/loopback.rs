//! The firmware's logic in this process, on a thread with memory of its own.

use super::error::DeviceError;
use super::transport::Transport;
use embedded_io::{ErrorType, Read, Write};
use half::f16;
use ommatidia_shared::device::{Arenas, Clock, Device, Line, RamObject, Silent, VirtualCamera, serve};
use ommatidia_shared::flash::RamFlash;
use std::convert::Infallible;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Memory of the simulated device.
#[derive(Clone, Copy, Debug)]
pub struct LoopbackConfig {
    /// Flash with two slots for network files, bytes.
    pub flash_bytes: usize,
    /// Room for the raw frame, pixels.
    pub frame_px: usize,
    /// Room for the reconstruction, pixels.
    pub object_px: usize,
    /// Fast memory, bytes.
    pub fast_bytes: usize,
    /// Bulk memory, bytes.
    pub bulk_bytes: usize,
    /// Rows and columns of the frames of a virtual camera at first; 0 and 0: no camera.
    pub camera: [u16; 2],
}

impl Default for LoopbackConfig {
    /// The memory of the default board.
    fn default() -> Self {
        Self {
            flash_bytes: 6 << 20,
            frame_px: 512 << 10,
            object_px: 512 << 10,
            fast_bytes: 512 << 10,
            bulk_bytes: 8 << 20,
            camera: [0, 0],
        }
    }
}

/// A device in this process.
#[derive(Debug)]
pub struct Loopback {
    to: Option<Sender<Vec<u8>>>,
    from: Receiver<Vec<u8>>,
    pending: Vec<u8>,
    thread: Option<JoinHandle<Result<(), DeviceError>>>,
}

impl Loopback {
    /// Starts it.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn start(config: LoopbackConfig) -> Result<Self, DeviceError> {
        Self::start_on(config, None)
    }

    /// Starts it with the flash that `state` holds, which is written back when the program ends ([`Self::finish`]).
    ///
    /// # Errors
    /// The file cannot be read or will not be writable, or the thread cannot be started.
    pub fn start_on(config: LoopbackConfig, state: Option<PathBuf>) -> Result<Self, DeviceError> {
        if let Some(state) = &state {
            writable(state).map_err(|error| DeviceError::state(state, error))?;
        }
        let (to, inbox) = channel();
        let (outbox, from) = channel();
        let link = Link { inbox, outbox, pending: Vec::new() };
        let thread = std::thread::Builder::new().name("device".into()).spawn(move || play(config, link, state))?;
        Ok(Self { to: Some(to), from, pending: Vec::new(), thread: Some(thread) })
    }

    /// Ends the program and waits until its flash is in its file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> Result<(), DeviceError> {
        self.end()
    }

    /// Closing the line ends the program.
    fn end(&mut self) -> Result<(), DeviceError> {
        self.to = None;
        let ended = self.thread.take().map(JoinHandle::join);
        ended.unwrap_or(Ok(Ok(()))).unwrap_or_else(|_| Err(std::io::Error::other("the program has failed").into()))
    }
}

impl Drop for Loopback {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            tracing::error!("{error}");
        }
    }
}

/// Whether a file can be written, or made where there is none; leaves no trace.
fn writable(file: &Path) -> std::io::Result<()> {
    if file.exists() {
        return OpenOptions::new().write(true).open(file).map(|_| ());
    }
    OpenOptions::new().write(true).create_new(true).open(file)?;
    std::fs::remove_file(file)
}

/// Runs the device's program on a line until the line closes, then writes its flash to the file `state`.
///
/// # Errors
/// The file cannot be read or written.
pub(super) fn play<L: Read + Write>(
    config: LoopbackConfig,
    mut link: L,
    state: Option<PathBuf>,
) -> Result<(), DeviceError> {
    let mut flash = vec![0u128; config.flash_bytes.div_ceil(16)];
    let flash: &mut [u8] = &mut bytemuck::cast_slice_mut(&mut flash)[..config.flash_bytes];
    if let Some(state) = state.as_ref().filter(|state| state.exists()) {
        read_into(flash, state).map_err(|error| DeviceError::state(state, error))?;
    }
    let mut frame = vec![0u16; config.frame_px];
    let mut object = vec![f16::ZERO; config.object_px];
    let mut fast = vec![0f32; config.fast_bytes / size_of::<f32>()];
    let mut bulk = vec![f16::ZERO; config.bulk_bytes / size_of::<f16>()];
    let mut line = Box::new(Line::new());
    let mut device = Device::new(
        "host",
        RamFlash::new(&mut *flash),
        VirtualCamera::new(&mut frame, config.camera, CLOCK),
        RamObject::new(&mut object),
        Arenas { fast: &mut fast, bulk: &mut bulk },
        Silent,
    );
    // A line that fails is a line that is closed.
    let _ = serve(&mut link, &mut line, &mut device);
    match state {
        Some(state) => keep(&state, flash).map_err(|error| DeviceError::state(&state, error)),
        None => Ok(()),
    }
}

/// Fills the flash from the start of its file; what a shorter file lacks stays zero.
fn read_into(flash: &mut [u8], state: &Path) -> std::io::Result<()> {
    let mut bytes = Vec::new();
    File::open(state)?.take(flash.len() as u64).read_to_end(&mut bytes)?;
    flash[..bytes.len()].copy_from_slice(&bytes);
    Ok(())
}

/// The clock of a virtual camera in this process.
const CLOCK: Clock = Clock { now_us, pause: || std::thread::sleep(Duration::from_micros(200)) };

/// Microseconds since the first call.
fn now_us() -> u64 {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_micros().try_into().unwrap_or(u64::MAX)
}

/// Writes the flash to the start of its file and keeps the rest of the file (other memory of an emulated board).
fn keep(state: &Path, flash: &[u8]) -> std::io::Result<()> {
    let fresh = !state.exists();
    let mut file = OpenOptions::new().create(true).truncate(false).write(true).open(state)?;
    file.write_all(flash).inspect_err(|_| {
        // A part of a flash is none: the next start would refuse it.
        if fresh {
            let _ = std::fs::remove_file(state);
        }
    })
}

/// The device's end.
struct Link {
    inbox: Receiver<Vec<u8>>,
    outbox: Sender<Vec<u8>>,
    pending: Vec<u8>,
}

impl ErrorType for Link {
    type Error = Infallible;
}

impl Read for Link {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        if self.pending.is_empty() {
            match self.inbox.recv() {
                Ok(bytes) => self.pending = bytes,
                Err(_) => return Ok(0),
            }
        }
        Ok(take(&mut self.pending, buffer))
    }
}

impl Write for Link {
    fn write(&mut self, buffer: &[u8]) -> Result<usize, Infallible> {
        // Nobody may be listening any more: then the next read ends the program.
        let _ = self.outbox.send(buffer.to_vec());
        Ok(buffer.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl Transport for Loopback {
    fn send(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        // A line that lost every byte of a packet has nothing to hand over; an empty read would mean "closed".
        if let Some(to) = self.to.as_ref().filter(|_| !bytes.is_empty()) {
            to.send(bytes.to_vec()).map_err(|_| std::io::Error::other("the program has ended"))?;
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], patience: Duration) -> Result<usize, DeviceError> {
        if self.pending.is_empty() {
            match self.from.recv_timeout(patience) {
                Ok(bytes) => self.pending = bytes,
                Err(RecvTimeoutError::Timeout) => return Ok(0),
                Err(RecvTimeoutError::Disconnected) => Err(std::io::Error::other("the program has ended"))?,
            }
        }
        Ok(take(&mut self.pending, buffer))
    }
}

/// Moves bytes from the front of `pending` to `buffer`.
fn take(pending: &mut Vec<u8>, buffer: &mut [u8]) -> usize {
    let count = pending.len().min(buffer.len());
    buffer[..count].copy_from_slice(&pending[..count]);
    pending.drain(..count);
    count
}
