//! A live view in the browser: a page with the last reconstruction and its figures, served by this process.

use super::stream::StreamedFrame;
use crate::http::{self, Answer, Request, Status};
use serde_json::json;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

const PAGE: &str = include_str!("view.html");
const SCRIPT: &str = include_str!("view.js");

/// A browser that shows the page asks again within this time.
const LOOKS_WITHIN: Duration = Duration::from_millis(500);

/// Content of the page.
#[derive(Debug, Default)]
struct Shown {
    /// The picture, PNG.
    png: Vec<u8>,
    /// Its figures, JSON.
    state: String,
    /// When a browser asked for them last.
    asked: Option<Instant>,
}

/// The live view; it works with or without a browser.
#[derive(Debug)]
pub struct LiveView {
    shown: Arc<Mutex<Shown>>,
    address: Option<SocketAddr>,
}

impl LiveView {
    /// A view that is not served.
    pub fn none() -> Self {
        Self { shown: Arc::default(), address: None }
    }

    /// Serves the page at `address`, e.g. `127.0.0.1:8080`, until the process ends.
    ///
    /// # Errors
    /// The address is in use, or other computers reach it.
    pub fn serve(address: SocketAddr) -> std::io::Result<Self> {
        let shown: Arc<Mutex<Shown>> = Arc::default();
        let mine = Arc::clone(&shown);
        let address = http::serve(address, move |request| answer(request, &mine))?;
        Ok(Self { shown, address: Some(address) })
    }

    /// Address of the page; `None` if it is not served.
    pub fn address(&self) -> Option<SocketAddr> {
        self.address
    }

    /// Shows a reconstruction; its maximum is white.
    pub fn show(&self, frame: &StreamedFrame) {
        if self.address.is_none() {
            return;
        }
        let values: Vec<f32> = frame.object.iter().map(|half| half.to_f32()).collect();
        let max = values.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        let grey: Vec<u8> = values.iter().map(|value| (255.0 * value / max).round() as u8).collect();
        let mut png = Vec::new();
        let mut encoder = png::Encoder::new(&mut png, frame.report.region.cols.into(), frame.report.region.rows.into());
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        if encoder.write_header().and_then(|mut writer| writer.write_image_data(&grey)).is_err() {
            return;
        }
        let state = json!({
            "frame": frame.frame, "seconds": frame.at.as_secs_f64(), "dropped": frame.dropped,
            "dropped_before": frame.dropped_before, "saturated_px": frame.report.saturated_px, "max": max,
            "field_frame": frame.field_frame, "exact": frame.report.field_age == 0,
        });
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        (shown.png, shown.state) = (png, state.to_string());
    }

    /// Says on the page that the stream has ended, and waits a moment for a browser that is looking to show it.
    pub fn end(&self) {
        let looking = {
            let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
            if shown.state.is_empty() {
                return;
            }
            shown.state = shown.state.replacen('{', "{\"ended\":true,", 1);
            shown.asked.is_some_and(|asked| asked.elapsed() < LOOKS_WITHIN)
        };
        if looking {
            std::thread::sleep(LOOKS_WITHIN);
        }
    }
}

/// Answers one request of a browser.
fn answer(request: &Request, shown: &Mutex<Shown>) -> Answer {
    let mut shown = shown.lock().unwrap_or_else(PoisonError::into_inner);
    let path: Vec<&str> = request.path.iter().map(String::as_str).collect();
    match path[..] {
        [] => Answer::new("text/html; charset=utf-8", PAGE),
        ["view.js"] => Answer::new("text/javascript; charset=utf-8", SCRIPT),
        ["state"] => {
            shown.asked = Some(Instant::now());
            Answer::new("application/json", shown.state.clone())
        }
        ["frame.png"] => Answer::new("image/png", shown.png.clone()),
        _ => Answer::refused(Status::NotFound, "there is no such page"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use half::f16;
    use ommatidia_shared::image::Region;
    use ommatidia_shared::wire::RunReport;
    use std::io::{Read, Write};
    use std::net::TcpStream;

    fn get(address: SocketAddr, path: &str) -> Vec<u8> {
        let mut stream = TcpStream::connect(address).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        answer
    }

    #[test]
    fn a_browser_gets_the_page_the_picture_and_the_numbers() {
        let view = LiveView::serve("127.0.0.1:0".parse().unwrap()).unwrap();
        let address = view.address().unwrap();
        let report = RunReport {
            id: 1,
            region: Region::whole(2, 3),
            field_id: 1,
            field_age: 4,
            len: 12,
            saturated_px: 5,
            frame_max_dn: 1.0,
            filter_finite: true,
            frame_crc: 0,
            object_crc: 0,
            capture: None,
            watch: Default::default(),
        };
        let object = [0.0, 0.25, 0.5, 0.0, 0.0, 0.0].map(f16::from_f32).to_vec();
        let (at, field_frame) = (Duration::ZERO, 3);
        let frame = StreamedFrame {
            frame: 7,
            at,
            dropped_before: 2,
            dropped: 3,
            missed_before: 0,
            restarted_before: false,
            field_frame,
            report,
            object,
        };
        view.show(&frame);
        let text = |path| String::from_utf8_lossy(&get(address, path)).into_owned();
        for (path, words) in
            [("/", "name=\"viewport\""), ("/", "<h1>"), ("/view.js", "frame.png"), ("/view.js", "ended")]
        {
            assert!(text(path).contains(words), "{words}");
        }
        for field in ["\"dropped\":3", "\"exact\":false", "\"field_frame\":3"] {
            assert!(text("/state").contains(field), "{}", text("/state"));
        }
        assert!(!text("/state").contains("ended"));
        view.end();
        let body = text("/state").split("\r\n\r\n").nth(1).map(str::to_string).unwrap();
        let state: serde_json::Value = serde_json::from_str(&body).unwrap();
        assert!(state["ended"] == true && state["frame"] == 7, "{state}");
        assert!(text("/elsewhere").starts_with("HTTP/1.1 404"));
        let picture = get(address, "/frame.png?n=1");
        let at = picture.windows(4).position(|bytes| bytes == b"\r\n\r\n").unwrap() + 4;
        let mut reader = png::Decoder::new(std::io::Cursor::new(&picture[at..])).read_info().unwrap();
        let mut pixels = vec![0; 6];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, [0, 128, 255, 0, 0, 0]);
    }
}
