//! Rows of the table, and what it takes for them to hold.

use crate::common::{contents, desk};
use crate::rights::{as_nobody, set_mode};
use crate::space::Space;
use std::path::Path;
use std::process::Command;

/// Rewrites the page instead of comparing it.
const WRITE: &str = "OMMATIDIA_RENEW";

/// One mistake: a row of the table.
pub struct Mistake {
    what: String,
    command: String,
    prepare: Box<dyn Fn(&Path) + Sync>,
    exit: i32,
    says: Vec<String>,
    path: Option<String>,
    unprivileged: bool,
    unreadable: Option<&'static str>,
    full: Option<&'static str>,
}

impl Mistake {
    /// `what` somebody did wrong, and the `command` that is then run on a desk (see [`desk`]), without the program's
    /// name.
    /// The command is expected to fail with exit code 1.
    pub fn new(what: impl Into<String>, command: impl Into<String>) -> Self {
        Self {
            what: what.into(),
            command: command.into(),
            prepare: Box::new(|_| ()),
            exit: 1,
            says: Vec::new(),
            path: None,
            unprivileged: false,
            unreadable: None,
            full: None,
        }
    }

    /// Makes the mistake: changes the files of the desk before the command runs.
    pub fn with(self, prepare: impl Fn(&Path) + Sync + 'static) -> Self {
        Self { prepare: Box::new(prepare), ..self }
    }

    /// The exit code to expect: 0 where a warning is enough, 2 for usage errors.
    pub fn exit(self, exit: i32) -> Self {
        Self { exit, ..self }
    }

    /// Key words that the printed text must hold.
    pub fn says(self, words: &[&str]) -> Self {
        Self { says: words.iter().map(ToString::to_string).collect(), ..self }
    }

    /// The program finds no other programs: no emulator, no compiler.
    pub fn without_other_programs(self) -> Self {
        Self { path: Some(String::new()), ..self }
    }

    /// The program runs with the rights of a user who owns nothing, so that permissions hold for it even where the
    /// tests
    /// run as root.
    pub fn unprivileged(self) -> Self {
        Self { unprivileged: true, ..self }
    }

    /// A file or folder of the desk that the program may not read; it runs as [`Mistake::unprivileged`].
    pub fn unreadable(self, path: &'static str) -> Self {
        Self { unreadable: Some(path), ..self.unprivileged() }
    }

    /// A folder of the desk, new and empty, on a disk that is full ([`Space`]).
    pub fn full_disk(self, folder: &'static str) -> Self {
        Self { full: Some(folder), ..self }
    }

    /// Runs the command on a desk of its own, checks the outcome, and gives the row of the page.
    fn row(&self) -> Result<String, String> {
        let desk = desk::new();
        (self.prepare)(desk.path());
        let before = contents(desk.path());
        let mut command = match self.full {
            Some(folder) => Space::found().command(&desk.path().join(folder)),
            None if self.unprivileged => as_nobody(desk.path()),
            None => Command::new(env!("CARGO_BIN_EXE_ommatidia")),
        };
        let locked = self.unreadable.map(|path| desk.path().join(path));
        let mode = locked.as_ref().map(|path| set_mode(path, 0));
        command
            .args(self.command.split_whitespace())
            .current_dir(desk.path())
            .env_remove("RUST_LOG")
            .env("NO_COLOR", "1");
        if let Some(path) = &self.path {
            command.env("PATH", path);
        }
        let output = command.output().unwrap();
        if let Some((path, mode)) = locked.as_ref().zip(mode) {
            set_mode(path, mode);
        }
        let printed = String::from_utf8_lossy(&output.stderr).replace(&*desk.path().to_string_lossy(), ".");
        let printed = if self.full.is_some() { Space::found().as_full(&printed) } else { printed };
        let printed: String = printed.split_inclusive('\n').filter(|line| !is_progress(line)).collect();
        let fail = |why: String| Err(format!("{} (`{}`): {why}; printed:\n{printed}", self.what, self.command));
        if output.status.code() != Some(self.exit) {
            return fail(format!("expected exit code {}, found {:?}", self.exit, output.status.code()));
        }
        if printed.contains("panicked") {
            return fail("it panicked".into());
        }
        if let Some(word) = self.says.iter().find(|word| !printed.contains(*word)) {
            return fail(format!("`{word}` is not in the text"));
        }
        let after = contents(desk.path());
        if let Some((path, _)) = before.iter().find(|(path, bytes)| after.get(*path) != Some(bytes)) {
            return fail(format!("{} changed", path.display()));
        }
        if let (true, Some(path)) = (self.exit != 0, after.keys().find(|path| !before.contains_key(*path))) {
            return fail(format!("{} was left behind", path.display()));
        }
        let cell = |text: &str| text.trim().replace('|', "\\|").replace('\n', "<br>");
        Ok(format!("| {} | `{}` | {} | {} |\n", cell(&self.what), self.command, self.exit, cell(&printed)))
    }
}

/// Whether a line says how far a command is: `calibrate: 12 of 49, 15 s`. Only slow machines print such lines.
fn is_progress(line: &str) -> bool {
    let counts = |text: &str| text.chars().all(|c| c.is_ascii_digit() || " ,of".contains(c));
    line.trim_end().strip_suffix(" s").and_then(|text| text.split_once(": ")).is_some_and(|(_, text)| counts(text))
}

/// Runs the rows of a section and compares them with the page, `docs/mistakes.md`.
pub fn hold(section: &str, mistakes: Vec<Mistake>) {
    let rows: Vec<Result<String, String>> = mistakes.iter().map(Mistake::row).collect();
    let wrong: Vec<&str> = rows.iter().filter_map(|row| row.as_ref().err().map(String::as_str)).collect();
    assert!(wrong.is_empty(), "{} of {} rows do not hold:\n{}", wrong.len(), rows.len(), wrong.join("\n\n"));
    let head = "| what happened | command | exit code | what is printed |\n|---|---|---|---|\n";
    let table = format!("{head}{}", rows.into_iter().map(Result::unwrap).collect::<String>());
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/mistakes.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let title = format!("## {section}\n");
    let begin = page.find(&title).map(|at| at + title.len()).expect("the page has a heading for the section");
    let end = page[begin..].find("\n## ").map_or(page.len(), |at| begin + at);
    let shown = page[begin..end].find("| what happened").map_or("", |at| &page[begin..end][at..]);
    if std::env::var_os(WRITE).is_some() {
        let text = page[begin..end - shown.len()].trim_end();
        let gap = if text.is_empty() { "\n" } else { "\n\n" };
        std::fs::write(&path, format!("{}{text}{gap}{table}{}", &page[..begin], &page[end..])).unwrap();
        return;
    }
    let plain = |text: &str| text.trim().replace(|c: char| c.is_ascii_digit(), "#").replace("##", "#");
    let differs =
        plain(shown).lines().zip(plain(&table).lines()).find(|(a, b)| a != b).map(|(a, b)| format!("{a}\n{b}"));
    assert!(
        differs.is_none() && plain(shown).lines().count() == plain(&table).lines().count(),
        "docs/mistakes.md shows, under `{section}`, and the program prints:\n{}\nto write the page again: see main.rs",
        differs.unwrap_or_else(|| "another number of rows".into()),
    );
}
