//! The tutorial is true: its commands run in the order of the page, from an empty folder, and print what the page says.
//!
//! Every block of `docs/tutorial.md` that is marked `sh` is run by `sh -eu`. A block marked `text` after it shows lines
//! of what these commands print, without what follows on the line: words must be equal, numbers must agree within
//! [`TOLERANCE`].
#![cfg(unix)]
#![allow(clippy::unwrap_used)]

mod program;

use program::program;
use std::path::{Path, PathBuf};
use std::process::Command;

/// How far a printed number may be from the one on the page, relative to it: other processors round other sums.
const TOLERANCE: f64 = 0.1;
/// Numbers closer than this agree, whatever their size.
const SMALL: f64 = 1e-3;
/// Most bytes of a picture of the documentation.
const PICTURE_BYTES: u64 = 200_000;

/// A block of code of a Markdown page.
struct Block {
    language: String,
    /// Line of its fence, counted from 1.
    line: usize,
    text: String,
}

/// The fenced blocks of a page, in order.
fn blocks(page: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut open: Option<Block> = None;
    for (i, line) in page.lines().enumerate() {
        match (line.strip_prefix("```"), open.as_mut()) {
            (Some(language), None) => {
                open = Some(Block { language: language.trim().into(), line: i + 1, text: String::new() });
            }
            (Some(_), Some(_)) => blocks.extend(open.take()),
            (None, Some(block)) => block.text.extend([line, "\n"]),
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "a block of the page has no end");
    blocks
}

/// Whether `printed` begins with the words of `shown`, numbers within the tolerance.
fn begins_as(printed: &str, shown: &str) -> bool {
    let mut printed = printed.split_whitespace();
    shown.split_whitespace().all(|shown| printed.next().is_some_and(|word| agree(word, shown)))
}

/// Whether two words are equal, or numbers (with the same signs around them) that agree.
fn agree(printed: &str, shown: &str) -> bool {
    if printed == shown {
        return true;
    }
    let (Some(a), Some(b)) = (number(printed), number(shown)) else { return false };
    a.1 == b.1 && (a.0 - b.0).abs() <= (TOLERANCE * b.0.abs()).max(SMALL)
}

/// The number in a word, and the punctuation around it.
fn number(word: &str) -> Option<(f64, String)> {
    let is_part = |c: char| c.is_ascii_digit() || "+-.e".contains(c);
    let inner = word.trim_matches(|c| !is_part(c));
    let around = word.replacen(inner, "", 1);
    Some((inner.parse().ok()?, around))
}

/// Folders that commands are looked for in: that of the program first.
fn search_path() -> std::ffi::OsString {
    let own = program().parent().unwrap().to_path_buf();
    let others = std::env::var_os("PATH").unwrap_or_default();
    std::env::join_paths(std::iter::once(own).chain(std::env::split_paths(&others))).unwrap()
}

fn documentation() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs")
}

#[test]
fn commands_of_the_tutorial_print_what_it_says() {
    let page = std::fs::read_to_string(documentation().join("tutorial.md")).unwrap();
    let (folder, path) = (tempfile::tempdir().unwrap(), search_path());
    let (mut printed, mut ran, mut compared) = (String::new(), 0, 0);
    for block in blocks(&page) {
        let place = format!("docs/tutorial.md:{}", block.line);
        match block.language.as_str() {
            "sh" => {
                let mut shell = Command::new("sh");
                shell.args(["-eu", "-c", &block.text]).current_dir(folder.path()).env("PATH", &path);
                let output = shell.output().unwrap();
                printed = String::from_utf8_lossy(&output.stdout).into_owned();
                let errors = String::from_utf8_lossy(&output.stderr);
                assert_eq!(output.status.code(), Some(0), "{place}: {}\n{printed}\n{errors}", block.text);
                ran += 1;
            }
            "text" => {
                for shown in block.text.lines().filter(|line| !line.trim().is_empty()) {
                    let found = printed.lines().any(|line| begins_as(line, shown));
                    assert!(found, "{place}: expected the line\n{shown}\nfound\n{printed}");
                    compared += 1;
                }
            }
            _ => {}
        }
    }
    assert!(ran >= 9 && compared >= 20, "{ran} blocks of commands and {compared} lines are fewer than the page has");
}

#[test]
fn pages_show_pictures_that_exist_and_are_small() {
    let docs = documentation();
    for page in ["../README.md", "tutorial.md"] {
        let text = std::fs::read_to_string(docs.join(page)).unwrap();
        let folder = docs.join(page).parent().unwrap().to_path_buf();
        let pictures: Vec<&str> = text
            .split("](")
            .skip(1)
            .filter_map(|rest| rest.split(')').next())
            .filter(|p| p.ends_with(".png"))
            .collect();
        assert!(!pictures.is_empty(), "{page} shows no picture");
        for picture in pictures {
            let bytes =
                std::fs::metadata(folder.join(picture)).unwrap_or_else(|e| panic!("{page}: {picture}: {e}")).len();
            assert!(
                bytes < PICTURE_BYTES,
                "{page}: {picture}: expected less than {PICTURE_BYTES} bytes, found {bytes}"
            );
        }
    }
}

#[test]
fn lines_agree_by_words_and_within_the_tolerance_of_numbers() {
    assert!(begins_as("gain   0.3999 +- 0.0008 DN/e-   measured", "gain 0.41 +- 0.0009 DN/e-"));
    assert!(!begins_as("gain   0.3999 +- 0.0008 DN/e-", "gain 0.48 +- 0.0008 DN/e-"));
    assert!(!begins_as("gain   0.3999", "gain 0.3999 DN/e-"));
    assert!(begins_as("array_shift (optics, z = 24.9), explains 93 %", "array_shift (optics, z = 25.2), explains"));
    assert!(!begins_as("array_shift (optics, z = 24.9)", "lens_decentre (optics, z = 24.9)"));
    assert!(!agree("24.9)", "24.9,"));
}
