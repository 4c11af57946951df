//! A board on a serial port.

use super::error::DeviceError;
use super::transport::Transport;
use serialport::SerialPort;
use std::io::ErrorKind;
use std::time::{Duration, Instant};

/// Default rate of the serial line, bits per second.
pub const BAUD: u32 = 921_600;

/// The longest wait for bytes, so that a board that was unplugged is noticed.
const WAIT: Duration = Duration::from_millis(200);
/// The longest wait for a line that takes no more bytes.
const SEND_WITHIN: Duration = Duration::from_secs(1);

/// The longest wait for another program to let go of the port: it may just be ending, or starting a program of its own,
/// which holds what it has inherited for a moment.
const FREE_WITHIN: Duration = Duration::from_millis(500);

/// A serial port with a board: 8 data bits, no parity, one stop bit.
#[derive(Debug)]
pub struct Serial {
    port: Box<dyn SerialPort>,
    name: String,
}

impl Serial {
    /// Opens a port, e.g. `/dev/ttyACM0` or `COM3`, at `baud` bits per second, and drops bytes received before. Waits
    /// for up to half a second where another program holds the port.
    ///
    /// # Errors
    /// The port does not exist, access is denied, or another program goes on holding it.
    pub fn open(name: &str, baud: u32) -> Result<Self, DeviceError> {
        let refused = |source: serialport::Error| {
            let advice = advice(source.kind());
            DeviceError::Port { port: name.into(), source, advice }
        };
        let start = Instant::now();
        let port = loop {
            match serialport::new(name, baud).timeout(WAIT).open() {
                Err(error) if error.kind() == serialport::ErrorKind::NoDevice && start.elapsed() < FREE_WITHIN => {
                    std::thread::sleep(FREE_WITHIN / 20);
                }
                opened => break opened.map_err(refused)?,
            }
        };
        port.clear(serialport::ClearBuffer::Input).map_err(refused)?;
        Ok(Self { port, name: name.into() })
    }

    fn gone(&self, source: std::io::Error) -> DeviceError {
        DeviceError::Unplugged { port: self.name.clone(), source }
    }
}

/// What to do about a port that cannot be opened.
fn advice(kind: serialport::ErrorKind) -> &'static str {
    use serialport::ErrorKind::{Io, NoDevice};
    match kind {
        Io(ErrorKind::NotFound) => "is the board plugged in? Linux lists its ports with `ls /dev/ttyACM* /dev/ttyUSB*`",
        Io(ErrorKind::PermissionDenied) => {
            "join the group that may use it (Debian, Ubuntu: `sudo usermod -aG dialout $USER`) and log in again"
        }
        NoDevice => "close the other program that uses it, or plug the board in",
        _ => "is it a serial port, and does it support that rate (`--baud`)?",
    }
}

impl Transport for Serial {
    fn send(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        self.port.set_timeout(SEND_WITHIN).map_err(|error| self.gone(error.into()))?;
        match self.port.write_all(bytes) {
            // A line that takes no more bytes for now loses them; the host asks again.
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => Ok(()),
            sent => sent.map_err(|error| self.gone(error)),
        }
    }

    fn receive(&mut self, buffer: &mut [u8], patience: Duration) -> Result<usize, DeviceError> {
        let wait = patience.clamp(Duration::from_millis(1), WAIT);
        self.port.set_timeout(wait).map_err(|error| self.gone(error.into()))?;
        match self.port.read(buffer) {
            Ok(0) => Err(self.gone(ErrorKind::UnexpectedEof.into())),
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => Ok(0),
            came => came.map_err(|error| self.gone(error)),
        }
    }

    /// A board goes on running when the host leaves.
    fn ends(&self) -> bool {
        false
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::*;
    use crate::device::footprint::small_network;
    use crate::device::loopback::{LoopbackConfig, play};
    use crate::device::{Client, FrameFeed, Frames, RunRequest, Runtime, Scope, camera, run, status, stream};
    use ommatidia_shared::device::Response;
    use ommatidia_shared::wire::CameraChange;
    use serialport::TTYPort;
    use std::io::{Read, Write};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::thread::JoinHandle;

    /// The device's end of a pseudo terminal. It stays while nobody has the other end open.
    struct Link {
        port: TTYPort,
        unplugged: Arc<AtomicBool>,
    }

    impl embedded_io::ErrorType for Link {
        type Error = std::convert::Infallible;
    }

    impl embedded_io::Read for Link {
        fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Self::Error> {
            while !self.unplugged.load(Ordering::Relaxed) {
                match self.port.read(buffer) {
                    Ok(count) if count > 0 => return Ok(count),
                    _ => std::thread::sleep(Duration::from_millis(1)),
                }
            }
            Ok(0)
        }
    }

    impl embedded_io::Write for Link {
        fn write(&mut self, buffer: &[u8]) -> Result<usize, Self::Error> {
            Ok(self.port.write(buffer).unwrap_or(buffer.len()))
        }

        fn flush(&mut self) -> Result<(), Self::Error> {
            Ok(())
        }
    }

    /// A device behind a pseudo terminal.
    struct Board {
        port: String,
        unplugged: Arc<AtomicBool>,
        device: JoinHandle<()>,
    }

    impl Board {
        fn plugged(config: LoopbackConfig) -> Self {
            let (theirs, ours) = TTYPort::pair().unwrap();
            let unplugged = Arc::new(AtomicBool::new(false));
            let link = Link { port: theirs, unplugged: Arc::clone(&unplugged) };
            let device = std::thread::spawn(move || play(config, link, None).unwrap());
            Self { port: ours.name().unwrap(), unplugged, device }
        }

        fn runtime(&self) -> Runtime {
            Runtime::Serial { port: self.port.clone(), baud: BAUD }
        }

        fn unplug(self) {
            self.unplugged.store(true, Ordering::Relaxed);
            self.device.join().unwrap();
        }
    }

    #[test]
    fn a_board_behind_a_serial_port_gives_the_same_bits_and_goes_on() {
        let board = Board::plugged(LoopbackConfig::default());
        let (blob, frame) = small_network().unwrap();
        for runs in 1..3 {
            let frames: [Vec<u16>; 1] = [frame.iter().map(|code| code + runs).collect()];
            let run = run(&board.runtime(), &blob, RunRequest::from(frames.as_slice()), None, &mut |_| {}).unwrap();
            assert_eq!((run.board.as_str(), run.differing_bits, run.objects.len()), ("host", 0, 1));
            let (_, telemetry) = status(&board.runtime(), None).unwrap();
            assert_eq!((telemetry.runs, telemetry.slots.iter().flatten().count()), (u32::from(runs), 1));
        }
        board.unplug();
    }

    /// A board goes on between conversations: it keeps the settings of its camera, and gives every stream a new frame.
    #[test]
    fn a_camera_keeps_its_settings_and_gives_a_new_frame_to_every_stream() {
        let (blob, frame) = small_network().unwrap();
        let board = Board::plugged(LoopbackConfig { camera: [16, 16], ..LoopbackConfig::default() });
        let change = CameraChange { exposure_us: Some(5_009), led_permille: Some(500), ..CameraChange::default() };
        let (_, set) = camera(&board.runtime(), None, change).unwrap();
        assert_eq!((set.settings.exposure_us, set.settings.led_permille), (5_000, 502));
        let mut last = 0;
        for n in 0..2 {
            let source = Frames::Camera(CameraChange::default());
            let feed = FrameFeed { len: 1, fps: None, nth: 1, scope: Scope::default(), source };
            let mut seen = Vec::new();
            stream(&board.runtime(), None, &blob, feed, &mut |frame| {
                seen.push(frame.report);
                Ok(())
            })
            .unwrap();
            let capture = seen[0].capture.unwrap();
            assert_eq!(capture.settings, set.settings);
            assert!(n == 0 || capture.number > last);
            last = capture.number;
            let response = Response::of(&set.settings, 502);
            let bytes: Vec<u8> = (0..frame.len()).flat_map(|i| response.code(n, i).to_le_bytes()).collect();
            assert_eq!(seen[0].frame_crc, ommatidia_shared::wire::checksum(&bytes));
        }
        let (_, now) = camera(&board.runtime(), None, CameraChange::default()).unwrap();
        assert_eq!((now.settings, now.frames, now.failed_frames), (set.settings, 2, 0));
        assert!((10_000..20_000).contains(&now.lit_us), "two exposures of 5 ms: {}", now.lit_us);
        board.unplug();
    }

    #[test]
    fn a_port_that_another_program_is_about_to_leave_is_waited_for() {
        let board = Board::plugged(LoopbackConfig::default());
        let other = Serial::open(&board.port, BAUD).unwrap();
        let leaves = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(150));
            drop(other);
        });
        Serial::open(&board.port, BAUD).unwrap();
        leaves.join().unwrap();
        board.unplug();
    }

    #[test]
    fn a_board_that_is_unplugged_is_reported_at_once() {
        let board = Board::plugged(LoopbackConfig::default());
        let (mut client, _) = Client::connect(Serial::open(&board.port, BAUD).unwrap()).unwrap();
        board.unplug();
        let start = Instant::now();
        let error = client.telemetry().unwrap_err();
        assert!(matches!(error, DeviceError::Unplugged { .. }), "{error}");
        assert!(start.elapsed() < Duration::from_secs(2));
        assert!(["lost", "Plug it in"].iter().all(|words| error.to_string().contains(words)), "{error}");
    }

    #[test]
    fn a_port_that_cannot_be_opened_is_reported_with_advice() {
        let message = |port: &str| Serial::open(port, BAUD).unwrap_err().to_string();
        let missing = message("/dev/no-such-port");
        assert!(missing.contains("/dev/no-such-port") && missing.contains("plugged in"), "{missing}");
        let no_port = message("/dev/null");
        assert!(no_port.contains("is it a serial port"), "{no_port}");
        let board = Board::plugged(LoopbackConfig::default());
        let first = Serial::open(&board.port, BAUD).unwrap();
        let taken = message(&board.port);
        assert!(taken.contains("other program"), "{taken}");
        drop(first);
        board.unplug();
        assert!(advice(serialport::ErrorKind::Io(ErrorKind::PermissionDenied)).contains("dialout"));
    }
}
