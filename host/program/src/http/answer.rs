//! What a browser gets.

use std::fmt::Write;

/// Outcome of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Done.
    Ok,
    /// The request is no request.
    Malformed,
    /// The request names another host.
    Forbidden,
    /// There is nothing of this name.
    NotFound,
    /// Only GET and HEAD are answered.
    Method,
    /// The request did not arrive in time.
    Slow,
    /// The request is too long.
    TooLong,
    /// The file cannot be shown.
    Unshown,
    /// Too many requests at once.
    Busy,
}

impl Status {
    /// Its line in HTTP.
    pub(super) fn line(self) -> &'static str {
        match self {
            Self::Ok => "200 OK",
            Self::Malformed => "400 Bad Request",
            Self::Forbidden => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::Method => "405 Method Not Allowed",
            Self::Slow => "408 Request Timeout",
            Self::TooLong => "431 Request Header Fields Too Large",
            Self::Unshown => "422 Unprocessable Content",
            Self::Busy => "503 Service Unavailable",
        }
    }
}

/// What a page may load and do: nothing but what this server sends, and it is shown in no other page.
const OWN: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; \
    connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'";

/// What a page of unknown origin may do: show its own text and pictures. No script of it runs.
const STRANGE: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action \
    'none'; frame-ancestors 'self'";

/// What a browser gets.
#[derive(Clone, Debug)]
pub struct Answer {
    status: Status,
    media: &'static str,
    policy: &'static str,
    notes: Vec<(&'static str, String)>,
    body: Vec<u8>,
}

impl Answer {
    /// Content of a media type, such as `image/png`.
    pub fn new(media: &'static str, body: impl Into<Vec<u8>>) -> Self {
        Self { status: Status::Ok, media, policy: OWN, notes: Vec::new(), body: body.into() }
    }

    /// A request that is refused, and why.
    pub fn refused(status: Status, why: &str) -> Self {
        Self { status, ..Self::new("text/plain; charset=utf-8", format!("{why}\n")) }
    }

    /// A page that was found in a file: no script of it runs, and it loads nothing.
    pub fn page_of_a_file(body: impl Into<Vec<u8>>) -> Self {
        Self { policy: STRANGE, ..Self::new("text/html; charset=utf-8", body) }
    }

    /// The same with a further header. Characters that a header cannot hold become `?`.
    pub fn note(mut self, name: &'static str, value: impl ToString) -> Self {
        let plain = |c: char| if c == ' ' || c.is_ascii_graphic() { c } else { '?' };
        self.notes.push((name, value.to_string().chars().map(plain).collect()));
        self
    }

    /// Its outcome.
    pub fn status(&self) -> Status {
        self.status
    }

    /// Its content.
    pub fn body(&self) -> &[u8] {
        &self.body
    }

    /// Everything before the content.
    pub(super) fn head(&self) -> String {
        let mut head = format!(
            "HTTP/1.1 {}\r\nContent-Type: {}\r\nContent-Length: {}\r\nContent-Security-Policy: {}\r\n\
             Cross-Origin-Resource-Policy: same-origin\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: \
             no-referrer\r\nCache-Control: no-store\r\nConnection: close\r\n",
            self.status.line(),
            self.media,
            self.body.len(),
            self.policy
        );
        if self.status == Status::Method {
            head += "Allow: GET, HEAD\r\n";
        }
        for (name, value) in &self.notes {
            // Writing to a string cannot fail.
            let _ = write!(head, "{name}: {value}\r\n");
        }
        head + "\r\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_cannot_end_early() {
        let answer = Answer::new("text/plain", "x").note("Label", "a\r\nSet-Cookie: µ");
        assert!(answer.head().contains("\r\nLabel: a??Set-Cookie: ?\r\n\r\n"), "{}", answer.head());
    }
}
