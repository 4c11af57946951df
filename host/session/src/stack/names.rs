//! Which files of a folder are one stack, by their names: alike but for a number that differs in each.

use crate::error::SessionError;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Most names that an error lists.
const MOST_LISTED: usize = 6;

/// Puts the TIFFs of a folder in the order of the numbers in their names.
///
/// # Errors
/// They are not one recording: some names differ in more than numbers, or no number differs in each file and gives the
/// order. Names with stage positions x and y may be any.
pub(super) fn in_order(folder: &Path, mut files: Vec<PathBuf>) -> Result<Vec<PathBuf>, SessionError> {
    // Two names of the same numbers, `f1` and `f01`, follow each other in the same order everywhere.
    files.sort_by_cached_key(|p| (natural(&name(p)), name(p)));
    if files.len() < 2 || files.iter().all(|p| has_position(&stem(p))) || are_continued(&files) {
        return Ok(files);
    }
    // `a1` is another name than `a`, which does not end in one.
    let words = |file: &Path| -> (Vec<String>, bool) {
        let stem = stem(file);
        (natural(&stem).into_iter().map(|(text, _)| text).collect(), stem.ends_with(|c: char| c.is_ascii_digit()))
    };
    let mut alike: BTreeMap<(Vec<String>, bool), Vec<&PathBuf>> = BTreeMap::new();
    files.iter().for_each(|file| alike.entry(words(file)).or_default().push(file));
    let wrong = |found: String| {
        let expected = "one recording in names that are alike but for one number, as 0.tif, 1.tif, ...";
        let remedy = "put each recording, each channel and each picture that is no frame into a folder of its own";
        Err(SessionError::value(folder, "TIFF files", expected, found, remedy))
    };
    if alike.len() > 1 {
        // Where most are alike the others are odd; where no kind has most, one of each kind shows it.
        let most = alike.iter().find(|(_, kind)| 2 * kind.len() > files.len());
        let odd = alike.iter().filter(|(words, _)| most.is_none_or(|(usual, _)| usual != *words));
        return wrong(match most {
            Some((_, most)) => {
                let odd: Vec<&PathBuf> = odd.flat_map(|(_, kind)| kind.iter().copied()).collect();
                format!("{} beside {} files like {}", listed(&odd), most.len(), name(most[0]))
            }
            None => format!("{}, each with another name", listed(&odd.map(|(_, kind)| kind[0]).collect::<Vec<_>>())),
        });
    }
    let numbers: Vec<Vec<u128>> =
        files.iter().map(|file| natural(&stem(file)).into_iter().map(|(_, n)| n).collect()).collect();
    // Others may change with it, such as the time beside the number; the order must be the same by either.
    let counts = |at: usize| numbers.windows(2).all(|pair| pair[0][at] < pair[1][at]);
    if (0..numbers[0].len()).any(counts) || is_time(&numbers) {
        return Ok(files);
    }
    if let Some(at) = numbers.windows(2).position(|pair| pair[0] == pair[1]) {
        return wrong(format!("{} and {} with the same number", name(&files[at]), name(&files[at + 1])));
    }
    let last = name(&files[files.len() - 1]);
    wrong(format!("{} to {last}, in which no number differs in every file", name(&files[0])))
}

/// Whether the files are one OME-TIFF in several, as Micro-Manager writes them above 4 GB: `a.ome.tif`, `a_1.ome.tif`,
/// `a_2.ome.tif`, without a gap.
fn are_continued(files: &[PathBuf]) -> bool {
    let first = stem(&files[0]);
    let Some(first) = first.strip_suffix(".ome") else { return false };
    files.iter().enumerate().skip(1).all(|(i, file)| stem(file) == format!("{first}_{i}.ome"))
}

/// Whether the numbers are dates with a time of day, which together give the order: year, month, day, hours, minutes,
/// seconds, and parts of a second.
fn is_time(numbers: &[Vec<u128>]) -> bool {
    let limits = [(1970, 2200), (1, 12), (1, 31), (0, 23), (0, 59), (0, 60)];
    let is_date = |numbers: &[u128]| limits.iter().zip(numbers).all(|((least, most), n)| (least..=most).contains(&n));
    let at = numbers[0].windows(6).position(is_date);
    at.is_some_and(|at| {
        let before = &numbers[0][..at];
        numbers.iter().all(|n| n[..at] == *before && is_date(&n[at..])) && numbers.windows(2).all(|p| p[0] < p[1])
    })
}

/// Whether a name holds numbers behind the letters x and y at the start of a word: a stage position. Whether it can be
/// read, with its sign and its unit, is for the reader of positions.
fn has_position(stem: &str) -> bool {
    let stem = stem.to_lowercase();
    let of = |letter: char| {
        stem.match_indices(letter).any(|(at, _)| {
            let rest = stem[at + 1..].trim_start_matches(['=', '_', ' ', '+', '-', '\u{2212}', '\u{2013}', 'm']);
            !stem[..at].ends_with(char::is_alphabetic) && rest.starts_with(|c: char| c.is_ascii_digit())
        })
    };
    of('x') && of('y')
}

/// Names in a message.
pub(super) fn listed(files: &[&PathBuf]) -> String {
    let mut names: Vec<String> = files.iter().take(MOST_LISTED).map(|p| name(p)).collect();
    if files.len() > MOST_LISTED {
        names.push(format!("{} more", files.len() - MOST_LISTED));
    }
    match names.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} and {last}", rest.join(", ")),
        _ => names.concat(),
    }
}

pub(super) fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// The last number in the name of a file.
pub(super) fn last_number(path: &Path) -> Option<u64> {
    let stem = path.file_stem()?.to_string_lossy().into_owned();
    let digits = stem.trim_end_matches(|c: char| !c.is_ascii_digit());
    let start = digits.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    digits[start..].parse().ok()
}

/// A key that sorts names by the numbers in them: `f2` before `f10`. What follows the last number has zero.
pub(super) fn natural(name: &str) -> Vec<(String, u128)> {
    let mut parts: Vec<(String, u128)> = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let text = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let digits = &rest[text..];
        let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
        let number = if end == 0 { 0 } else { digits[..end].parse().unwrap_or(u128::MAX) };
        parts.push((rest[..text].to_lowercase(), number));
        rest = &digits[end..];
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(names: &[&str]) -> Result<Vec<String>, String> {
        let files = names.iter().map(PathBuf::from).collect();
        in_order("rec".as_ref(), files).map(|f| f.iter().map(|p| name(p)).collect()).map_err(|e| e.to_string())
    }

    #[test]
    fn names_that_count_are_one_recording() {
        for names in [
            vec!["one picture.tif"],
            vec!["0.tif", "1.tif", "2.TIFF", "10.tif"],
            vec!["img_000.tif", "img_001.tif", "img_007.tif"],
            vec!["mouse3_day5_1.tif", "mouse3_day5_2.tif", "mouse3_day5_11.tif"],
            // The time beside the number, and times alone.
            vec!["f1_20.5ms.tif", "f2_61.0ms.tif", "f3_99.5ms.tif"],
            vec!["2026-11-20_12-00-58.tif", "2026-11-20_12-00-59.tif", "2026-11-20_12-01-00.tif"],
            vec!["99999999999999999999_a.tif", "100000000000000000000_a.tif"],
            vec!["a_Pos0.ome.tif", "a_Pos0_1.ome.tif", "a_Pos0_2.ome.tif"],
            // Stage positions.
            vec!["x-10um_y0um.tif", "x0um_y-10um.tif", "x10um_y10um.tif"],
            vec!["x_m10um_y0um.tif", "x_10um_y\u{2212}10um.tif"],
            vec!["bead_X=0.12mm_Y=0_003.tif", "bead_X=1mm_Y=0_003.tif"],
        ] {
            let mut shuffled = names.clone();
            shuffled.reverse();
            let mut found = of(&shuffled).unwrap_or_else(|e| panic!("{e}"));
            if names[0].to_lowercase().contains('x') {
                found.sort();
                shuffled.sort_unstable();
                assert_eq!(found, shuffled);
            } else {
                assert_eq!(found, names);
            }
        }
    }

    #[test]
    fn what_is_no_frame_of_one_recording_is_named() {
        for (names, parts) in [
            (vec!["i_0.tif", "i_1.tif", "i_2.tif", "AVG_i.tif"], &["found AVG_i.tif beside 3 files like i_0.tif;"][..]),
            (vec!["i_0.tif", "i_1.tif", "i_2.tif", "AVG_i_0.tif"], &["AVG_i_0.tif beside 3"]),
            (vec!["a_0.tif", "a_1.tif", "b_0.tif", "b_1.tif"], &["found a_0.tif and b_0.tif, each with another name"]),
            (
                vec!["c0_t0.tif", "c1_t0.tif", "c0_t1.tif", "c1_t1.tif"],
                &["c0_t0.tif to c1_t1.tif, in which no number differs in every file"],
            ),
            // The channels alternate, and their order is not that of the last number.
            (vec!["c0_t0.tif", "c1_t1.tif", "c0_t2.tif", "c1_t3.tif"], &["in which no number differs"]),
            (vec!["f1.tif", "f01.tif", "f2.tif"], &["found f01.tif and f1.tif with the same number"]),
            (vec!["a_Pos0.ome.tif", "a_Pos0_1.ome.tif", "a_Pos0_3.ome.tif"], &["a_Pos0.ome.tif beside 2 files"]),
            (vec!["i.tif", "i1.tif", "i2.tif"], &["found i.tif beside 2 files like i1.tif"]),
            (vec!["a.tif", "b.tif"], &["found a.tif and b.tif"]),
            (vec!["x0um_y0um.tif", "x1um_y0um.tif", "dark.tif"], &["dark.tif"]),
        ] {
            let error = of(&names).unwrap_err();
            assert!(parts.iter().all(|p| error.contains(p)) && error.contains("folder of its own"), "{error}");
        }
    }
}
