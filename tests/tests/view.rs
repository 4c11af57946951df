//! `ommatidia view`: the program serves a page, and what it sends is what is in the files. A browser draws the page.
#![allow(clippy::unwrap_used)]

#[path = "program/mod.rs"]
mod program;

use ndarray::{Array2, Array3};
use ommatidia_closing::{Account, Closing};
use ommatidia_session::artifact::Provenance;
use ommatidia_session::stack;
use ommatidia_session::{
    Existing, FrameInfo, Manifest, Role, SampleType, Session, SessionWriter, StackEntry, StackSpec,
};
use program::program;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// The program, serving; it ends with the value.
struct Server {
    child: Child,
    address: String,
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Server {
    fn start(arguments: &[&Path]) -> Self {
        let mut command = Command::new(program());
        command.arg("view").args(arguments).args(["--json", "--quiet"]).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let said: Value = serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: `{line}`"));
        let url = said["url"].as_str().unwrap();
        let address = url.trim_start_matches("http://").trim_end_matches('/').to_string();
        assert!(address.starts_with("127.0.0.1:"), "{address}");
        Self { child, address }
    }

    /// What a request gets: its status, its header, its content.
    fn send(&self, request: &str) -> (u16, String, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
        let head = String::from_utf8(answer[..end].to_vec()).unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, head, answer.split_off(end + 4))
    }

    fn get(&self, target: &str) -> (u16, String, Vec<u8>) {
        self.send(&format!("GET {target} HTTP/1.1\r\nHost: {}\r\n\r\n", self.address))
    }

    fn text(&self, target: &str) -> (u16, String) {
        let (status, _, body) = self.get(target);
        (status, String::from_utf8_lossy(&body).into_owned())
    }

    fn json(&self, target: &str) -> Value {
        let (status, text) = self.text(target);
        assert_eq!(status, 200, "{target}: {text}");
        serde_json::from_str(&text).unwrap()
    }

    /// A picture: its samples as numbers, and its description.
    fn picture(&self, target: &str) -> (Vec<f32>, Value) {
        let (status, head, body) = self.get(target);
        assert_eq!(status, 200, "{target}: {}", String::from_utf8_lossy(&body));
        let about: Value = serde_json::from_str(header(&head, "Picture")).unwrap();
        let values = match about["samples"].as_str().unwrap() {
            "uint16" => body.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]).into()).collect(),
            "float32" => body.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
            other => panic!("{other}"),
        };
        (values, about)
    }
}

fn header<'a>(head: &'a str, name: &str) -> &'a str {
    head.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": ")).unwrap()
}

/// A session, an instrument, the account of a closed loop, a stack, a page, and a file that cannot be shown.
fn files(folder: &Path) {
    let instrument = ommatidia_model::testing::instrument([9, 11], [30, 33], 5, 3);
    instrument.write(&folder.join("lab.instrument"), Provenance::default()).unwrap();
    session(&folder.join("session"), &instrument.manifest);
    let map = |from: f32| Array3::from_shape_fn((2, 30, 33), |(i, r, c)| from + (1000 * i + 33 * r + c) as f32);
    let closing = Closing { session: "by hand".into(), held_out_frames: vec![5], ..Closing::default() };
    let account = Account {
        closing,
        frames: vec![3, 5],
        measured_dn: map(64.0),
        before: map(0.0),
        after: map(-7.0),
        specimens: None,
    };
    account.write(&folder.join("closed.closing"), Provenance::new("close", 1, &())).unwrap();
    stack::write(&folder.join("objects.npy"), Array3::from_elem((2, 9, 11), 0.25).view()).unwrap();
    std::fs::write(folder.join("page.html"), "<!doctype html><p>x<script>document.body.dataset.ran = 1 + 1</script>")
        .unwrap();
    std::fs::write(folder.join("notes.csv"), "a,b\n").unwrap();
    std::fs::create_dir(folder.join("recording")).unwrap();
    for name in ["recording/0.tif", "recording/1.tif"] {
        stack::write(&folder.join(name), Array3::from_shape_fn((2, 5, 6), |(_, r, c)| (r + c) as f32).view()).unwrap();
    }
}

fn session(path: &Path, like: &Manifest) {
    let manifest = Manifest { stacks: Vec::new(), ..like.clone() };
    let mut writer = SessionWriter::create(path, &manifest, Existing::Keep).unwrap();
    let spec = StackSpec { frames: 4, rows: 30, cols: 33, samples: SampleType::U16, pixel_um: None };
    let mut frames = writer.frames("scene.npy", spec).unwrap();
    for i in 0..4 {
        frames.push(frame(i).view()).unwrap();
    }
    frames.finish().unwrap();
    let mut info: Vec<FrameInfo> =
        (0..4).map(|i| FrameInfo { z_um: 10.0 * (i / 2) as f64, ..FrameInfo::plain(i, 10.0) }).collect();
    info.iter_mut().for_each(|info| drop(info.other.insert("data".into(), "whole".into())));
    info[1].other.insert("data".into(), "damaged".into());
    writer.table("scene.csv", &info).unwrap();
    let entry = StackEntry::plain(Role::Scene, "scene.npy", 10.0);
    writer.add(StackEntry { table: Some("scene.csv".into()), ..entry });
    writer.finish().unwrap();
}

fn frame(i: usize) -> Array2<f32> {
    Array2::from_shape_fn((30, 33), |(r, c)| (64 + 300 * i + 33 * r + c) as f32)
}

/// Number of a file in the list.
fn number(list: &Value, name: &str) -> usize {
    let files = list["files"].as_array().unwrap();
    files.iter().position(|file| file["name"].as_str().is_some_and(|n| n.ends_with(name))).unwrap()
}

#[test]
fn what_is_sent_is_what_is_in_the_files() {
    let folder = tempfile::tempdir().unwrap();
    files(folder.path());
    let server = Server::start(&[folder.path()]);
    let list = server.json("/files");
    assert_eq!(list["files"].as_array().unwrap().len(), 7);
    let at = |name: &str| number(&list, name);
    assert_eq!(list["files"][at("notes.csv")]["kind"], "unshown");
    // A report is offered of what a report can draw.
    for n in (0..7).filter(|n| *n != at("notes.csv")) {
        let offered = server.json(&format!("/file/{n}"))["report"] == true;
        let (status, text) = server.text(&format!("/report/{n}"));
        assert!(!offered || status == 200, "{}: {text}", list["files"][n]["name"]);
        assert!(offered || n == at("page.html"), "{}", list["files"][n]["name"]);
    }

    let n = at("session");
    let shows = server.json(&format!("/file/{n}"))["shows"].clone();
    assert!(shows["notes"].to_string().contains("1 of 4 frames are marked as damaged (1)"), "{}", shows["notes"]);
    assert_eq!(shows["groups"][0]["z_um"], serde_json::json!([0.0, 0.0, 10.0, 10.0]));
    assert_eq!(shows["groups"][0]["panes"][0]["unit"], "DN");
    let read = Session::open(folder.path().join("session")).unwrap().stacks()[0].frames().unwrap().read(2).unwrap();
    let (values, about) = server.picture(&format!("/data/{n}/0/0/2"));
    assert_eq!(values, read.iter().copied().collect::<Vec<_>>());
    assert_eq!(values, frame(2).iter().copied().collect::<Vec<_>>());
    assert!(about["rows"] == 30 && about["cols"] == 33 && about["samples"] == "uint16", "{about}");
    assert_eq!(about["label"], "z 10 um, exposure 10 ms");

    let n = at("objects.npy");
    let (values, about) = server.picture(&format!("/data/{n}/0/0/1"));
    assert!(values.len() == 99 && values.iter().all(|v| *v == 0.25) && about["look"] == "inferno", "{about}");
    let shows = server.json(&format!("/file/{n}"))["shows"].clone();
    assert_eq!(shows["groups"][0]["panes"][0]["plane"], "object");

    let n = at("closed.closing");
    let shows = server.json(&format!("/file/{n}"))["shows"].clone();
    assert_eq!(shows["groups"][0]["swipe"], serde_json::json!([1, 2]));
    let (values, about) = server.picture(&format!("/data/{n}/0/4/1"));
    assert_eq!((values[3], about["label"].as_str()), (996.0, Some("frame 5, held out of every fit")));
    let (values, _) = server.picture(&format!("/data/{n}/0/4/0"));
    assert!(values[7].is_nan() && values[6] == -1.0, "a residual of 0 is no value: {:?}", &values[..9]);

    let n = at("lab.instrument");
    let geometry = server.json(&format!("/geometry/{n}"));
    let instrument = ommatidia_model::testing::instrument([9, 11], [30, 33], 5, 3);
    assert_eq!(geometry["anchors_px"], serde_json::json!(instrument.geometry.anchors_px));
    let (status, head, body) = server.get(&format!("/psf/{n}?depth=0&y_um=2.5&x_um=-4"));
    assert_eq!(status, 200, "{}", String::from_utf8_lossy(&body));
    let foci = ommatidia_model::forward::Forward::new(&instrument).unwrap().foci([2.5, -4.0], 5).unwrap();
    let sent: Vec<f32> = body.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    assert_eq!(sent, foci.windows_e.iter().copied().collect::<Vec<_>>());
    let about: Value = serde_json::from_str(header(&head, "Foci")).unwrap();
    assert_eq!(about["chief_rays_px"], serde_json::json!(foci.chief_rays_px));

    let (status, report) = server.text(&format!("/report/{n}"));
    assert!(status == 200 && report.contains("Point-spread functions"), "{status}");
    let (status, head, page) = server.get(&format!("/raw/{}", at("page.html")));
    assert!(
        status == 200
            && head.contains("Content-Security-Policy: default-src 'none'; style")
            && page.ends_with(b"</script>"),
        "{head}"
    );
    for (path, words) in [
        ("/", "<title>"),
        ("/view.js", "fetch("),
        ("/draw.js", "canvas"),
        ("/psf.js", "psf"),
        ("/style.css", "--paper"),
    ] {
        let (status, text) = server.text(path);
        assert!(status == 200 && text.contains(words), "{path}");
        assert!(!text.contains("https://") && !text.contains("//cdn"), "{path} loads something from the network");
    }
}

#[test]
fn hostile_requests_get_a_status_and_the_page_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    files(folder.path());
    let server = Server::start(&[folder.path()]);
    let list = server.json("/files");
    let (n, lab) = (number(&list, "session"), number(&list, "lab.instrument"));
    let unshown = number(&list, "notes.csv");
    let huge = "9".repeat(40);
    for (target, expected) in [
        ("/../../etc/passwd", 400),
        ("/data/..%2f..%2fetc%2fpasswd", 400),
        ("/%2e%2e/%2e%2e/etc/passwd", 400),
        ("/raw/etc/passwd", 404),
        ("/session.toml", 404),
        ("/file/99", 404),
        ("/file/-1", 404),
        (&*format!("/file/{huge}"), 404),
        (&*format!("/data/{n}/0/0/4"), 404),
        (&*format!("/data/{n}/0/0/{}", usize::MAX), 404),
        (&*format!("/data/{n}/0/0/{huge}"), 404),
        (&*format!("/data/{n}/1/0/0"), 404),
        (&*format!("/data/{n}/0/7/0"), 404),
        (&*format!("/data/{n}/0/0/0/0"), 404),
        (&*format!("/data/{unshown}/0/0/0"), 404),
        (&*format!("/file/{unshown}"), 422),
        (&*format!("/report/{unshown}"), 422),
        (&*format!("/raw/{n}"), 422),
        (&*format!("/geometry/{n}"), 404),
        (&*format!("/psf/{lab}"), 404),
        (&*format!("/psf/{lab}?depth=9&y_um=0&x_um=0"), 422),
        (&*format!("/psf/{lab}?depth=0&y_um=1e300&x_um=0"), 422),
        (&*format!("/psf/{lab}?depth=0&y_um=NaN&x_um=0"), 422),
        (&*format!("/reconstruct/{n}/0/0/0?with={lab}"), 404),
        (&*format!("/reconstruct/{n}/0/0/0"), 404),
    ] {
        let (status, text) = server.text(target);
        assert_eq!(status, expected, "{target}: {text}");
        assert!(!text.contains("root:") && !text.is_empty(), "{target}: {text}");
    }
    let of = |request: &str| server.send(request).0;
    assert_eq!(of("GET / HTTP/1.1\r\nHost: example.org\r\n\r\n"), 403);
    assert_eq!(of("GET / HTTP/1.1\r\n\r\n"), 400);
    assert_eq!(of(&format!("POST /files HTTP/1.1\r\nHost: {}\r\nContent-Length: 3\r\n\r\nabc", server.address)), 405);
    assert_eq!(of(&format!("GET /{} HTTP/1.1\r\nHost: localhost\r\n\r\n", "a".repeat(1 << 16))), 431);
    // Two browsers at once, and one that says nothing.
    let _silent = TcpStream::connect(&server.address).unwrap();
    std::thread::scope(|scope| {
        for worker in 0..8 {
            let server = &server;
            scope.spawn(move || {
                for i in 0..12 {
                    let frame_number = (i + worker) % 4;
                    let (values, _) = server.picture(&format!("/data/{n}/0/0/{frame_number}"));
                    assert_eq!(values, frame(frame_number).iter().copied().collect::<Vec<_>>());
                }
            });
        }
    });
    // A file that changes or vanishes while it is shown.
    let objects = number(&list, "objects.npy");
    assert_eq!(server.picture(&format!("/data/{objects}/0/0/1")).0[0], 0.25);
    stack::write(&folder.path().join("objects.npy"), Array3::from_elem((1, 9, 11), 0.5).view()).unwrap();
    assert_eq!(server.picture(&format!("/data/{objects}/0/0/0")).0[0], 0.5);
    assert_eq!(server.get(&format!("/data/{objects}/0/0/1")).0, 404);
    std::fs::remove_file(folder.path().join("objects.npy")).unwrap();
    let (status, text) = server.text(&format!("/data/{objects}/0/0/0"));
    assert!(status == 404 && text.contains("is gone"), "{status} {text}");
    assert_eq!(server.get("/files").0, 200);
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_it() {
    let folder = tempfile::tempdir().unwrap();
    files(folder.path());
    let mut server = Server::start(&[&folder.path().join("objects.npy")]);
    assert!(Command::new("kill").args(["-INT", &server.child.id().to_string()]).status().unwrap().success());
    assert_eq!(server.child.wait().unwrap().code(), Some(130));
    assert!(TcpStream::connect(&server.address).is_err());
}

/// The browser on this computer.
fn browser() -> Option<&'static str> {
    let names = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
    let starts = |name: &&str| {
        let mut command = Command::new(name);
        command.arg("--version").stdout(Stdio::null()).stderr(Stdio::null());
        command.status().is_ok_and(|status| status.success())
    };
    names.into_iter().find(starts)
}

/// The page as a browser has made it.
fn dom(browser: &str, url: &str, profile: &Path) -> String {
    let output = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=10000", "--window-size=1200,900"])
        .arg(format!("--user-data-dir={}", profile.display()))
        .args(["--dump-dom", url])
        .stderr(Stdio::null())
        .output()
        .unwrap();
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn a_browser_draws_the_page() {
    let Some(browser) = browser() else {
        let why = "no Chromium is on the PATH; install it (Debian, Ubuntu: `apt-get install chromium`)";
        return ommatidia_tests::skip("a_browser_draws_the_page", why);
    };
    let folder = tempfile::tempdir().unwrap();
    files(folder.path());
    let profile = tempfile::tempdir().unwrap();
    let server = Server::start(&[folder.path()]);
    let list = server.json("/files");
    let page = |name: &str, more: &str| {
        let url = format!("http://{}/#file={}{more}", server.address, number(&list, name));
        dom(browser, &url, profile.path())
    };
    let has = |page: &str, all: &[&str]| {
        for words in all {
            assert!(page.contains(words), "`{words}` is not in the page:\n{page}");
        }
    };
    // Values of frame 3: 964 to 1953. The colours go from the 1st to the 99.8th percentile.
    has(
        &page("session", "&frame=3"),
        &[
            "data-state=\"ready\"",
            "6 files",
            ">objects.npy<small>stack</small>",
            "not shown: it is an unknown file",
            "<dt>lenses</dt>",
            "data-low=\"973\"",
            "data-high=\"1951\"",
            "data-rows=\"30\"",
            "z 10 um",
            "Depth",
            "Lenses of",
        ],
    );
    has(
        &page("closed.closing", ""),
        &["data-state=\"ready\"", "before, mean of 5 × 5 | after, mean of 5 × 5", "class=\"swipe\""],
    );
    has(&page("lab.instrument", ""), &["data-psf=\"2 lenses\"", "chief ray row", "dots: beads of the scan"]);
    has(&page("page.html", ""), &["data-state=\"ready\"", "<iframe src=\"/raw/"]);
    // No script of a page that was found in a file runs.
    let found = dom(browser, &format!("http://{}/raw/{}", server.address, number(&list, "page.html")), profile.path());
    assert!(found.contains("<p>x") && !found.contains("data-ran"), "{found}");
    let url = format!("http://{}/#file=77", server.address);
    has(&dom(browser, &url, profile.path()), &["data-state=\"failed\"", "There is no such file"]);
}
