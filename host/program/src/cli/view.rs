//! `view`: files in the browser.

use super::common::{Outcome, Run, print};
use super::files::Files;
use crate::http;
use crate::view::{Kind, Listing, Site};
use anyhow::Context;
use serde_json::json;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// Options of `view`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Files and folders: frames, recordings, sessions, data sets, instruments, residuals, accounts of `close`,
    /// evaluations, networks, widths, reports, pictures. A folder shows all that is in it
    #[arg(required = true, value_name = "FILE-or-FOLDER")]
    paths: Vec<PathBuf>,
    /// Port of the page at 127.0.0.1 [default: one that is free]
    #[arg(long, value_name = "N", value_parser = port)]
    port: Option<u16>,
    /// Open the page in the browser
    #[arg(long)]
    open: bool,
}

fn port(text: &str) -> Result<u16, String> {
    let number = text.parse().ok().filter(|port: &u16| *port > 0);
    number.ok_or_else(|| {
        "expected a number from 1 to 65535; the page is only at 127.0.0.1, for browsers of this computer (from another \
         one: `ssh -L PORT:127.0.0.1:PORT`)"
            .into()
    })
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading(&self.paths).after_stop("the page is closed; no file was changed")
    }
}

/// Runs the verb: serves the page until Ctrl-C.
///
/// # Errors
/// No file can be shown, or the port is in use.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let listing = Listing::new(&args.paths)?;
    listing.refused.iter().for_each(|why| tracing::warn!("{why}"));
    let shown = listing.entries.iter().filter(|entry| entry.kind != Kind::Unshown).count();
    let site = Site::new(listing);
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port.unwrap_or(0)));
    let address = http::serve(address, move |request| site.answer(request)).with_context(|| {
        let other = "choose another with --port, or leave it out for one that is free";
        format!("port {}: the page cannot be served there; {other}", address.port())
    })?;
    let url = format!("http://{address}/");
    let files = if shown == 1 { "1 file".into() } else { format!("{shown} files") };
    let text = match run.json {
        true => format!("{}\n", json!({ "verb": "view", "url": url, "files": shown })),
        false => format!("{url} shows {files}; Ctrl-C ends it\n"),
    };
    print(text.as_bytes()).context("standard output")?;
    if args.open && !open(&url) {
        tracing::warn!("no browser was found: open {url} in one");
    }
    loop {
        // The page is served by threads of its own; Ctrl-C ends the process.
        std::thread::park();
    }
}

/// Opens an address in the browser of this system; whether there is one.
fn open(url: &str) -> bool {
    let programs: &[&[&str]] = if cfg!(target_os = "macos") {
        &[&["open"]]
    } else if cfg!(windows) {
        &[&["explorer"]]
    } else {
        &[&["xdg-open"], &["gio", "open"], &["sensible-browser"]]
    };
    programs.iter().any(|words| {
        let mut command = Command::new(words[0]);
        command.args(&words[1..]).arg(url).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command.spawn().is_ok()
    })
}
