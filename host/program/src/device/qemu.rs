//! An emulated board: the firmware under QEMU, over its emulated serial line.

use super::counter::Counter;
use super::emulator::Emulator;
use super::error::DeviceError;
use super::firmware::Firmware;
use super::transport::Transport;
use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Seek};
use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// QEMU sends each byte of the UART as a datagram. So many bytes, with what the packet adds, stay below the 270
/// datagrams that the receive buffer of a Linux socket holds.
const ANSWER_LEN: usize = 160;
/// A program that was asked to end does so within this time.
const END_WITHIN: Duration = Duration::from_secs(10);

/// An emulated board.
///
/// The UART is on a UDP port of the loopback interface, behind QEMU's multiplexer: the one back end that takes more
/// than one byte from the host at a time (the emulated UART itself holds one), which makes it ten times as fast as a
/// socket or a pipe. A datagram may be lost; the protocol tolerates it.
#[derive(Debug)]
pub struct Qemu {
    child: Arc<Mutex<Child>>,
    socket: UdpSocket,
    output: File,
}

impl Qemu {
    /// Starts the firmware, with an optional instruction counter. The flash of the board is the file `state`, which is
    /// created if it is missing and keeps its content however the emulation ends.
    ///
    /// # Errors
    /// QEMU is missing or cannot be started, or the file cannot be made.
    pub fn start(firmware: &Firmware, counter: Option<&Counter>, state: Option<&Path>) -> Result<Self, DeviceError> {
        let emulator = Emulator::find()?;
        let (socket, serial) = open_line()?;
        let output = tempfile::tempfile()?;
        let mut command = emulator.command();
        command.args(["-M", firmware.board().name, "-display", "none", "-monitor", "none"]);
        if let Some(state) = state {
            let bytes = firmware.board().memory_bytes;
            let file = OpenOptions::new().create(true).truncate(false).write(true).open(state);
            file.and_then(|file| file.set_len(bytes)).map_err(|error| DeviceError::state(state, error))?;
            let memory = format!("memory-backend-file,id=memory,size={bytes},share=on,mem-path={}", state.display());
            command.args(["-object", &memory, "-machine", "memory-backend=memory"]);
        }
        command.args(["-chardev", &serial, "-serial", "chardev:line"]);
        // The multiplexer's escape character: one that no byte equals.
        command.args(["-echr", "0x100", "-semihosting-config", "enable=on,target=native"]);
        if let Some(counter) = counter {
            command.args(["-plugin", &counter.argument()]);
        }
        command.arg("-kernel").arg(firmware.path());
        command.stdin(Stdio::null()).stdout(output.try_clone()?).stderr(output.try_clone()?);
        let child = command.spawn().map_err(|source| no_start(&emulator, source))?;
        Ok(Self { child: Arc::new(Mutex::new(child)), socket, output })
    }

    /// A handle that kills the emulator, as a power cut would.
    pub fn killer(&self) -> Killer {
        Killer(Arc::clone(&self.child))
    }

    /// Waits for a program that was asked to end.
    ///
    /// # Errors
    /// It does not end, or ends with a failure.
    pub fn wait(mut self) -> Result<(), DeviceError> {
        let deadline = Instant::now() + END_WITHIN;
        while Instant::now() < deadline {
            let status = lock(&self.child).try_wait()?;
            match status {
                Some(status) if status.success() => return Ok(()),
                Some(_) => return Err(self.stopped("failure".into())),
                None => std::thread::sleep(Duration::from_millis(5)),
            }
        }
        Err(self.stopped("it did not stop when asked to".into()))
    }

    /// Nothing came; that is fine as long as the emulator runs.
    fn still_running(&mut self) -> Result<usize, DeviceError> {
        let status = lock(&self.child).try_wait()?;
        match status {
            Some(status) => Err(self.stopped(status.to_string())),
            None => Ok(0),
        }
    }

    fn stopped(&mut self, status: String) -> DeviceError {
        let mut bytes = Vec::new();
        let read = self.output.rewind().and_then(|()| self.output.read_to_end(&mut bytes));
        let output = match read {
            Ok(_) => String::from_utf8_lossy(&bytes).trim().to_string(),
            Err(error) => format!("its output cannot be read ({error})"),
        };
        DeviceError::Stopped { status, output }
    }
}

/// Kills an emulator.
#[derive(Clone, Debug)]
pub struct Killer(Arc<Mutex<Child>>);

impl Killer {
    /// Kills it, if it still runs.
    pub fn kill(&self) {
        // Both fail only where the emulator has ended already.
        let mut child = lock(&self.0);
        let _ = child.kill();
        let _ = child.wait();
    }
}

/// The child is whole whatever became of a thread that held it.
fn lock(child: &Mutex<Child>) -> MutexGuard<'_, Child> {
    child.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs a program without a serial line to its end; returns its output.
///
/// # Errors
/// QEMU is missing, or the program fails.
pub fn run_to_end(firmware: &Firmware, counter: Option<&Counter>) -> Result<String, DeviceError> {
    let emulator = Emulator::find()?;
    let mut command = emulator.command();
    command.args(["-M", firmware.board().name, "-display", "none", "-monitor", "none", "-serial", "none"]);
    command.args(["-semihosting-config", "enable=on,target=native"]);
    if let Some(counter) = counter {
        command.args(["-plugin", &counter.argument()]);
    }
    command.arg("-kernel").arg(firmware.path()).stdin(Stdio::null());
    let output = command.output().map_err(|source| no_start(&emulator, source))?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    if output.status.success() {
        return Ok(text);
    }
    Err(DeviceError::Stopped { status: output.status.to_string(), output: text.trim().into() })
}

fn no_start(emulator: &Emulator, source: std::io::Error) -> DeviceError {
    DeviceError::Start { program: emulator.path().display().to_string(), source }
}

/// Our end of the line, and QEMU's description of its end.
fn open_line() -> Result<(UdpSocket, String), DeviceError> {
    let ours = UdpSocket::bind("127.0.0.1:0")?;
    // QEMU wants the number of a free port; the system knows one.
    let theirs = UdpSocket::bind("127.0.0.1:0")?.local_addr()?;
    ours.connect(theirs)?;
    let port = ours.local_addr()?.port();
    let (host, local) = (theirs.ip(), theirs.port());
    let serial = format!("udp,id=line,host={host},port={port},localaddr={host},localport={local},mux=on");
    Ok((ours, serial))
}

impl Drop for Qemu {
    fn drop(&mut self) {
        self.killer().kill();
    }
}

impl Transport for Qemu {
    fn send(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        match self.socket.send(bytes) {
            Ok(_) => Ok(()),
            // It has not opened its end yet: a lost packet.
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    fn receive(&mut self, buffer: &mut [u8], patience: Duration) -> Result<usize, DeviceError> {
        // Short waits, so that an emulator that ended is noticed.
        let wait = patience.min(Duration::from_millis(200)).max(Duration::from_millis(1));
        self.socket.set_read_timeout(Some(wait))?;
        match self.socket.recv(buffer) {
            Ok(count) => Ok(count),
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
                std::thread::sleep(Duration::from_millis(5));
                self.still_running()
            }
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => self.still_running(),
            Err(error) => Err(error.into()),
        }
    }

    fn answer_len(&self) -> usize {
        ANSWER_LEN
    }
}
