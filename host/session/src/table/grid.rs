//! Tables as people save them: text with commas, semicolons or tabs, with decimal points or commas.

use crate::error::SessionError;
use std::path::Path;

/// A table of text. Its cells are trimmed, and each row has one cell for each name.
#[derive(Debug)]
pub(crate) struct Grid {
    pub names: Vec<String>,
    pub rows: Vec<Row>,
    /// Character between cells.
    pub separator: u8,
}

/// One row of a table.
#[derive(Debug)]
pub(crate) struct Row {
    /// Line of the file, from 1.
    pub line: u64,
    pub cells: Vec<String>,
}

impl Grid {
    /// Reads a table with a header. Lines that begin with `#` are comments.
    ///
    /// # Errors
    /// The file cannot be read, has no header, or a row has more or fewer values than the header.
    pub fn read(path: &Path) -> Result<Self, SessionError> {
        let bytes = std::fs::read(path).map_err(|e| SessionError::io(path, e))?;
        Self::of(path, &bytes)
    }

    /// Reads the table of a recorder, whose last line is cut off where the recorder was. Returns what was left out, as
    /// the end of a sentence about the table.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_log(path: &Path) -> Result<(Self, Option<String>), SessionError> {
        let bytes = std::fs::read(path).map_err(|e| SessionError::io(path, e))?;
        // In UTF-16 every other byte is zero; recorders do not write it.
        if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
            return Ok((Self::of(path, &bytes)?, None));
        }
        // Blocks that a crashed system had reserved and not written are zero.
        let written = bytes.iter().rposition(|b| *b != 0).map_or(0, |i| i + 1);
        let start = bytes[..written].iter().rposition(|b| *b == b'\n').map_or(0, |i| i + 1);
        let (lines, last) = bytes[..written].split_at(start);
        let zeros = bytes.len() - written;
        if last.trim_ascii().is_empty() {
            let left_out =
                (zeros > 0).then(|| format!("is followed by {zeros} bytes that are zero, as a crash leaves them"));
            return Ok((Self::of(path, lines)?, left_out));
        }
        let cells = |line: &[u8]| line.iter().filter(|b| b",;\t".contains(b)).count();
        let head = lines.split(|b| *b == b'\n').find(|l| !l.trim_ascii().is_empty() && !l.starts_with(b"#"));
        let few = head.is_some_and(|head| cells(last) < cells(head));
        if start == 0 || !(few || zeros > 0) {
            return Ok((Self::of(path, &bytes)?, None));
        }
        let number = lines.iter().filter(|b| **b == b'\n').count() + 1;
        let text = String::from_utf8_lossy(last);
        let left_out = format!("ends within a line, which is left out: line {number}, `{}`", text.trim());
        Ok((Self::of(path, lines)?, Some(left_out)))
    }

    fn of(path: &Path, bytes: &[u8]) -> Result<Self, SessionError> {
        let text = decoded(path, bytes)?;
        // The reader counts lines that end with two characters one too low.
        let text = text.replace("\r\n", "\n");
        let (text, before) = without_hint(&text);
        let head = text.lines().map(str::trim).find(|l| !l.is_empty() && !l.starts_with('#')).unwrap_or("");
        let separator = separator(head);
        let mut csv = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            .delimiter(separator)
            .flexible(true)
            .from_reader(text.as_bytes());
        let broken = |e: csv::Error| SessionError::format(path, ".csv", e);
        let names: Vec<String> = csv.headers().map_err(broken)?.iter().map(String::from).collect();
        with_header(path, &names)?;
        let mut rows = Vec::new();
        for record in csv.records() {
            let record = record.map_err(broken)?;
            let line = record.position().map_or(0, |p| p.line()) + before;
            let mut cells: Vec<String> = record.iter().map(String::from).collect();
            // Spreadsheets end lines with separators.
            while cells.len() > names.len() && cells.last().is_some_and(String::is_empty) {
                cells.pop();
            }
            if cells.iter().all(String::is_empty) {
                continue;
            }
            let row = Row { line, cells };
            if row.cells.len() != names.len() {
                let remedy = match (row.cells.len() > names.len(), separator) {
                    (true, b',') => {
                        "numbers with decimal commas count as two: write decimal points (12.5), or semicolons between \
                         the values; or the header lacks a column"
                    }
                    (true, _) => "the header lacks a column, or a value holds a separator",
                    _ => "a value is missing: write one for each column",
                };
                let (expected, found) = (format!("{} values", names.len()), row.cells.len());
                let found = format!("{found} in `{}`", row.text(separator));
                return Err(SessionError::value(path, format!("line {line}"), expected, found, remedy));
            }
            rows.push(row);
        }
        Ok(Self { names, rows, separator })
    }

    /// The number in a cell, with a decimal point or, where commas do not separate cells, a decimal comma.
    pub fn number(&self, text: &str) -> Option<f64> {
        let text = text.replace('\u{2212}', "-");
        let found = text.parse().ok();
        let with_comma = || self.decimal_comma(&text).then(|| text.replace(',', ".").parse().ok()).flatten();
        found.or_else(with_comma)
    }

    /// Whether a cell holds a number with a decimal comma.
    pub fn decimal_comma(&self, text: &str) -> bool {
        let digits = |c: char| c.is_ascii_digit() || "+-\u{2212}eE,".contains(c);
        self.separator != b',' && text.matches(',').count() == 1 && text.chars().all(digits)
    }
}

impl Row {
    /// The row as the file has it.
    pub fn text(&self, separator: u8) -> String {
        self.cells.join(&char::from(separator).to_string()).replace('\t', " ")
    }
}

/// The text of a file: UTF-8 or, as some spreadsheets write it, UTF-16, with or without byte-order mark.
fn decoded(path: &Path, bytes: &[u8]) -> Result<String, SessionError> {
    match bytes {
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => {}
        _ if bytes.contains(&0) => return Err(SessionError::format(path, ".csv", "it holds bytes that are no text")),
        _ => {}
    }
    Ok(text_of(bytes))
}

/// The text of bytes, without byte-order mark: UTF-16 with one, else UTF-8. A stray character of an older encoding,
/// such as a micro sign, is no reason to refuse a text.
pub(crate) fn text_of(bytes: &[u8]) -> String {
    let wide = |big: bool| {
        let unit = |b: &[u8]| if big { u16::from_be_bytes([b[0], b[1]]) } else { u16::from_le_bytes([b[0], b[1]]) };
        String::from_utf16_lossy(&bytes[2..].chunks_exact(2).map(unit).collect::<Vec<_>>())
    };
    match bytes {
        [0xff, 0xfe, ..] => wide(false),
        [0xfe, 0xff, ..] => wide(true),
        _ => String::from_utf8_lossy(bytes).trim_start_matches('\u{feff}').to_string(),
    }
}

/// The text without the line `sep=;` of a spreadsheet, and the number of lines that were left out.
fn without_hint(text: &str) -> (&str, u64) {
    let hint = text.get(..4).is_some_and(|start| start.eq_ignore_ascii_case("sep="));
    match text.split_once('\n') {
        Some((_, rest)) if hint => (rest, 1),
        _ => (text, 0),
    }
}

fn separator(head: &str) -> u8 {
    [b';', b'\t'].into_iter().find(|s| head.contains(char::from(*s))).unwrap_or(b',')
}

/// Rejects tables without a header, and names between blanks.
fn with_header(path: &Path, names: &[String]) -> Result<(), SessionError> {
    let expected = "names of columns, separated by commas, semicolons or tabs";
    let found = names.join(",");
    if names.len() == 1 && names[0].split_whitespace().count() > 1 {
        let remedy = "the table looks separated by blanks: write commas between the values";
        return Err(SessionError::value(path, "header", expected, found, remedy));
    }
    let number = |n: &String| n.replace(',', ".").parse::<f64>().is_ok();
    if !names.is_empty() && names.iter().all(number) {
        let remedy =
            "the header row is missing: begin the table with the names of its columns, such as frame,x_um,y_um";
        return Err(SessionError::value(path, "header", expected, found, remedy));
    }
    Ok(())
}
