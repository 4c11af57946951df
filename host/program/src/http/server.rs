//! Listens, and gives each request a thread and a time limit.

use super::{Answer, Request, Status};
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Time limit for a request to arrive.
const ARRIVES_WITHIN: Duration = Duration::from_secs(3);
/// Time limit for its answer to be taken.
const TAKEN_WITHIN: Duration = Duration::from_secs(30);
/// Longest head of a request, bytes.
const LONGEST_HEAD: usize = 16 * 1024;
/// Most requests at once; a browser opens six connections for each page.
const MOST_AT_ONCE: usize = 64;

/// What answers requests.
type Site = dyn Fn(&Request) -> Answer + Send + Sync;

/// Serves a site at a loopback address until the process ends; gives the address (port 0: the system chooses one).
///
/// # Errors
/// The address is reached from other computers, is in use, or may not be used.
pub fn serve(
    address: SocketAddr,
    site: impl Fn(&Request) -> Answer + Send + Sync + 'static,
) -> std::io::Result<SocketAddr> {
    if !address.ip().is_loopback() {
        let why = "pages are only served to browsers of this computer: choose 127.0.0.1";
        return Err(std::io::Error::new(ErrorKind::AddrNotAvailable, why));
    }
    let listener = TcpListener::bind(address)?;
    let address = listener.local_addr()?;
    let (site, at_once): (Arc<Site>, _) = (Arc::new(site), Arc::new(AtomicUsize::new(0)));
    std::thread::Builder::new().name("http".into()).spawn(move || {
        for browser in listener.incoming() {
            let Ok(browser) = browser else {
                // No more connections are possible at the moment.
                std::thread::sleep(Duration::from_millis(20));
                continue;
            };
            // Beyond this, not even a refusal is worth a thread.
            if at_once.load(Ordering::Relaxed) > 2 * MOST_AT_ONCE {
                continue;
            }
            let turn = Turn::take(&at_once);
            let site = Arc::clone(&site);
            // A browser that has left is no loss, nor is one for which there is no thread.
            let _ = std::thread::Builder::new().name("request".into()).spawn(move || {
                let full = turn.0.load(Ordering::Relaxed) > MOST_AT_ONCE;
                let _ = converse(&browser, if full { None } else { Some(&*site) });
                drop(turn);
            });
        }
    })?;
    Ok(address)
}

/// Counts the requests at once.
struct Turn(Arc<AtomicUsize>);

impl Turn {
    fn take(at_once: &Arc<AtomicUsize>) -> Self {
        at_once.fetch_add(1, Ordering::Relaxed);
        Self(Arc::clone(at_once))
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Reads a request and answers it; without a site, there are too many at once.
fn converse(browser: &TcpStream, site: Option<&Site>) -> std::io::Result<()> {
    let (answer, head_only) = match (site, head(browser)) {
        (None, _) => (Answer::refused(Status::Busy, "too many requests at once: try again"), false),
        (Some(_), Err(refused)) => (refused?, false),
        (Some(site), Ok(head)) => match Request::parse(&head) {
            Ok(request) => (site(&request), request.head_only),
            Err(refused) => (refused, false),
        },
    };
    let end = Instant::now() + TAKEN_WITHIN;
    write_until(browser, answer.head().as_bytes(), end)?;
    if !head_only {
        write_until(browser, answer.body(), end)?;
    }
    // What the browser has sent beyond the head is read: else the system may discard the answer.
    browser.shutdown(Shutdown::Write)?;
    browser.set_read_timeout(Some(Duration::from_millis(200)))?;
    let mut beyond = [0; 4096];
    let mut stream = browser;
    for _ in 0..16 {
        if stream.read(&mut beyond)? == 0 {
            break;
        }
    }
    Ok(())
}

/// Reads the head of a request, up to the empty line; else the answer that refuses it.
fn head(mut browser: &TcpStream) -> Result<Vec<u8>, std::io::Result<Answer>> {
    let end = Instant::now() + ARRIVES_WITHIN;
    let slow = || Ok(Answer::refused(Status::Slow, "the request did not arrive in time"));
    let mut head: Vec<u8> = Vec::new();
    let mut piece = [0; 1024];
    loop {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(slow());
        }
        browser.set_read_timeout(Some(left)).map_err(Err)?;
        let n = match browser.read(&mut piece) {
            // The browser has left.
            Ok(0) => return Err(Err(ErrorKind::UnexpectedEof.into())),
            Ok(n) => n,
            Err(e) if e.kind() == ErrorKind::Interrupted => continue,
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => return Err(slow()),
            Err(e) => return Err(Err(e)),
        };
        // The empty line may lie across two pieces.
        let from = head.len().saturating_sub(3);
        head.extend_from_slice(&piece[..n]);
        if let Some(at) = head[from..].windows(4).position(|four| four == b"\r\n\r\n") {
            head.truncate(from + at);
            return Ok(head);
        }
        if head.len() > LONGEST_HEAD {
            return Err(Ok(Answer::refused(Status::TooLong, "the request is too long")));
        }
    }
}

/// Writes all bytes, or gives up at the end of the time.
fn write_until(mut browser: &TcpStream, mut bytes: &[u8], end: Instant) -> std::io::Result<()> {
    while !bytes.is_empty() {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        browser.set_write_timeout(Some(left))?;
        match browser.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(n) => bytes = &bytes[n..],
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn started() -> SocketAddr {
        serve("127.0.0.1:0".parse().unwrap(), |request| Answer::new("text/plain", request.path.join("+"))).unwrap()
    }

    fn ask(address: SocketAddr, pieces: &[&str]) -> String {
        let mut stream = TcpStream::connect(address).unwrap();
        for piece in pieces {
            stream.write_all(piece.as_bytes()).unwrap();
            stream.flush().unwrap();
        }
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }

    #[test]
    fn only_loopback_addresses_are_served() {
        for address in ["0.0.0.0:0", "192.0.2.1:0", "[::]:0"] {
            let error = serve(address.parse().unwrap(), |_| Answer::new("text/plain", "")).unwrap_err();
            assert!(error.to_string().contains("127.0.0.1"), "{address}: {error}");
        }
        let taken = started();
        assert_eq!(serve(taken, |_| Answer::new("", "")).unwrap_err().kind(), ErrorKind::AddrInUse);
    }

    #[test]
    fn requests_in_pieces_with_bodies_and_without_content_are_answered() {
        let address = started();
        let whole = ask(address, &["GET /a/b HTTP/1.1\r", "\nHost: localhost\r\n\r", "\n"]);
        assert!(whole.starts_with("HTTP/1.1 200 OK\r\n") && whole.ends_with("\r\n\r\na+b"), "{whole}");
        let head = ask(address, &["HEAD /a/b HTTP/1.1\r\nHost: localhost\r\n\r\n"]);
        assert!(head.contains("Content-Length: 3\r\n") && head.ends_with("\r\n\r\n"), "{head}");
        let post = ask(address, &["POST /a HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4\r\n\r\nbody"]);
        assert!(post.starts_with("HTTP/1.1 405 ") && post.contains("Allow: GET, HEAD"), "{post}");
    }

    #[test]
    fn long_and_slow_requests_are_refused_and_others_are_answered_meanwhile() {
        let address = started();
        let slow = std::thread::spawn(move || ask(address, &["GET / HTTP/1.1\r\n"]));
        let long = format!("GET / HTTP/1.1\r\nHost: localhost\r\nX: {}\r\n", "x".repeat(LONGEST_HEAD));
        assert!(ask(address, &[&long]).starts_with("HTTP/1.1 431 "));
        for _ in 0..20 {
            assert!(ask(address, &["GET /c HTTP/1.1\r\nHost: localhost\r\n\r\n"]).ends_with("\r\n\r\nc"));
        }
        assert!(slow.join().unwrap().starts_with("HTTP/1.1 408 "));
    }
}
