//! What a browser asks for. Requests are hostile input: whatever is not plainly right is refused.

use super::{Answer, Status};

/// A request that was understood.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// Whether the content itself is left out of the answer (HEAD).
    pub head_only: bool,
    /// The parts of the path between slashes; empty for `/`.
    pub path: Vec<String>,
    /// The names and values behind the question mark.
    query: Vec<(String, String)>,
}

impl Request {
    /// Understands the head of a request: everything before the empty line.
    ///
    /// # Errors
    /// The answer that refuses it: it is no request of HTTP/1, has another method than GET and HEAD, or names another
    /// host than this computer.
    pub fn parse(head: &[u8]) -> Result<Self, Answer> {
        let bad = |why: &str| Answer::refused(Status::Malformed, why);
        let text = std::str::from_utf8(head).map_err(|_| bad("the request is not text"))?;
        let mut lines = text.split("\r\n");
        let words: Vec<&str> = lines.next().unwrap_or_default().split(' ').collect();
        let [method, target, version] = words[..] else { return Err(bad("the request line has not three words")) };
        if !version.starts_with("HTTP/1.") {
            return Err(bad("the request is not HTTP/1"));
        }
        let head_only = match method {
            "GET" => false,
            "HEAD" => true,
            _ => return Err(Answer::refused(Status::Method, "only GET and HEAD are answered: nothing can be changed")),
        };
        let mut hosts = Vec::new();
        for line in lines.filter(|line| !line.is_empty()) {
            let (name, value) = line.split_once(':').ok_or_else(|| bad("a header line has no colon"))?;
            if name.eq_ignore_ascii_case("host") {
                hosts.push(value.trim());
            }
        }
        match hosts[..] {
            [host] if names_this_computer(host) => {}
            [host] => {
                let why = format!("this page is at localhost or 127.0.0.1, not at `{host}`");
                return Err(Answer::refused(Status::Forbidden, &why));
            }
            _ => return Err(bad("the request must name one host")),
        }
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        let path = path.strip_prefix('/').ok_or_else(|| bad("the path does not begin with a slash"))?;
        let parts = path.split('/').map(decoded).collect::<Option<Vec<String>>>();
        let mut path = parts.ok_or_else(|| bad("the path has a wrong escape"))?;
        if path.iter().any(|part| part == "." || part == ".." || part.contains(['/', '\\', '\0'])) {
            return Err(bad("the path leads elsewhere"));
        }
        if path.last().is_some_and(String::is_empty) {
            path.pop();
        }
        let pair = |pair: &str| {
            let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
            Some((decoded(name)?, decoded(value)?))
        };
        let query = query.split('&').filter(|p| !p.is_empty()).map(pair).collect::<Option<Vec<_>>>();
        Ok(Self { head_only, path, query: query.ok_or_else(|| bad("the query has a wrong escape"))? })
    }

    /// A value of the query, by its name.
    pub fn value(&self, name: &str) -> Option<&str> {
        self.query.iter().find(|(n, _)| n == name).map(|(_, value)| value.as_str())
    }

    /// A number of the query; None where it is missing or no number.
    pub fn number<T: std::str::FromStr>(&self, name: &str) -> Option<T> {
        self.value(name)?.parse().ok()
    }
}

/// Whether the value of a Host header names this computer, with any port: a tunnel may have another port than ours.
fn names_this_computer(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split_once(']').filter(|(_, port)| is_port(port)).map(|(name, _)| name),
        None => match host.find(':') {
            Some(at) => is_port(&host[at..]).then_some(&host[..at]),
            None => Some(host),
        },
    };
    name.is_some_and(|name| ["localhost", "127.0.0.1", "::1"].iter().any(|own| name.eq_ignore_ascii_case(own)))
}

/// Nothing, or a colon and digits.
fn is_port(text: &str) -> bool {
    text.is_empty()
        || text.strip_prefix(':').is_some_and(|port| !port.is_empty() && port.bytes().all(|b| b.is_ascii_digit()))
}

/// A text with its escapes (`%2F`) replaced; None where one is wrong.
fn decoded(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'%' => {
                let [high, low] = [rest.next()?, rest.next()?].map(|digit| char::from(digit).to_digit(16));
                u8::try_from(16 * high? + low?).ok()?
            }
            byte => byte,
        });
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn parse(line: &str, host: &str) -> Result<Request, Status> {
        let head = format!("{line}\r\nAccept: */*\r\nhOsT: {host}");
        Request::parse(head.as_bytes()).map_err(|answer| answer.status())
    }

    fn get(target: &str) -> Result<Request, Status> {
        parse(&format!("GET {target} HTTP/1.1"), "localhost:8080")
    }

    #[test]
    fn a_path_and_a_query_are_understood() {
        let request = get("/data/3/0?frame=12&name=a%20b%2Fc&flag").unwrap();
        assert_eq!(request.path, ["data", "3", "0"]);
        assert_eq!((request.number("frame"), request.value("name")), (Some(12usize), Some("a b/c")));
        assert_eq!(
            (request.value("flag"), request.value("other"), request.number::<usize>("name")),
            (Some(""), None, None)
        );
        assert!(get("/").unwrap().path.is_empty() && !request.head_only);
        assert!(parse("HEAD / HTTP/1.0", "127.0.0.1").unwrap().head_only);
    }

    #[test]
    fn paths_that_lead_elsewhere_are_refused() {
        for target in [
            "/../etc/passwd",
            "/data/../../x",
            "/%2e%2e/x",
            "/..%2f..%2fetc",
            "/a%2Fb",
            "/a%5Cb",
            "/a\\b",
            "/./x",
            "/%00",
            "/%zz",
            "/%",
            "/%e2%28%a1",
            "http://localhost/",
            "*",
            "",
            "/x?a=%f",
        ] {
            assert_eq!(get(target), Err(Status::Malformed), "{target}");
        }
    }

    #[test]
    fn only_this_computer_is_a_host() {
        for host in ["localhost", "LocalHost:1", "127.0.0.1:65535", "[::1]:8080", "[::1]"] {
            assert!(parse("GET / HTTP/1.1", host).is_ok(), "{host}");
        }
        for host in [
            "example.org",
            "localhost.example.org",
            "127.0.0.1.example.org",
            "localhost:",
            "localhost:80x",
            "[::1",
            "[::1]x",
            "0.0.0.0",
            "",
            "localhost:80:80",
            "user@localhost",
        ] {
            assert_eq!(parse("GET / HTTP/1.1", host), Err(Status::Forbidden), "{host}");
        }
        let of = |head: &str| Request::parse(head.as_bytes()).map_err(|answer| answer.status());
        assert_eq!(of("GET / HTTP/1.1"), Err(Status::Malformed));
        assert_eq!(of("GET / HTTP/1.1\r\nHost: localhost\r\nHost: localhost"), Err(Status::Malformed));
    }

    #[test]
    fn other_methods_and_other_protocols_are_refused() {
        for method in ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "get"] {
            assert_eq!(parse(&format!("{method} / HTTP/1.1"), "localhost"), Err(Status::Method), "{method}");
        }
        for line in ["GET /", "GET / HTTP/2", "GET  / HTTP/1.1", "GET / x HTTP/1.1", "", "\x16\x03\x01"] {
            assert_eq!(parse(line, "localhost"), Err(Status::Malformed), "{line}");
        }
        let bytes = Request::parse(b"GET /\xff HTTP/1.1\r\nHost: localhost").map_err(|answer| answer.status());
        assert_eq!(bytes, Err(Status::Malformed));
        let no_colon = Request::parse(b"GET / HTTP/1.1\r\nHost: localhost\r\nx").map_err(|answer| answer.status());
        assert_eq!(no_colon, Err(Status::Malformed));
    }
}
