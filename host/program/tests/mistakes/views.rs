//! Files in the browser: files that cannot be shown, and addresses where the page cannot be.

use crate::{Mistake, hold};
use std::net::TcpListener;

#[test]
fn files_and_addresses_that_a_page_cannot_have() {
    // The port stays taken as long as the process of the test lives.
    let taken = |_: &std::path::Path| {
        if let Ok(listener) = TcpListener::bind("127.0.0.1:48631") {
            Box::leak(Box::new(listener));
        }
    };
    let rows = vec![
        Mistake::new("A file that is not there", "view nothing.npy").says(&["nothing.npy", "check its name"]),
        Mistake::new("A file of an unknown kind", "view session/bead.csv").says(&["bead.csv", "an unknown file"]),
        Mistake::new("A folder without a file that can be shown", "view notes")
            .with(|desk| {
                std::fs::create_dir(desk.join("notes")).unwrap();
                std::fs::write(desk.join("notes/today.txt"), "nothing yet").unwrap();
            })
            .says(&["notes", "no file in this folder can be shown"]),
        Mistake::new("An instrument that is cut short", "view instrument")
            .with(|desk| {
                let bytes = std::fs::read(desk.join("instrument")).unwrap();
                std::fs::write(desk.join("instrument"), &bytes[..bytes.len() / 2]).unwrap();
            })
            .says(&["instrument", "cut short"]),
        Mistake::new("The port is in use", "view report.html --port 48631").with(taken).says(&[
            "port 48631",
            "in use",
            "--port",
        ]),
        Mistake::new("An address that other computers reach", "view report.html --port 0.0.0.0:8080")
            .exit(2)
            .says(&["127.0.0.1", "ssh -L"]),
        Mistake::new("No file", "view").exit(2).says(&["<FILE-or-FOLDER>"]),
    ];
    hold("Files in the browser", rows);
}
