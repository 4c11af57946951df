//! What is to be known of the files of a recording, beside what is lost of it.

use super::losses::count;
use crate::stack::FrameReader;

/// What is to be known of the files of a stack: videos beside them that are left out, codes of limited range.
pub fn notes_on(frames: &FrameReader) -> Vec<String> {
    let mut notes = Vec::new();
    let others = frames.left_out();
    if !others.is_empty() {
        let named = others.iter().take(3).cloned().collect::<Vec<_>>().join(", ");
        let more = if others.len() > 3 { format!(" and {} more", others.len() - 3) } else { String::new() };
        let are = if others.len() == 1 { "is a video" } else { "are videos" };
        notes.push(format!("{}: {named}{more} {are} of another camera and left out", frames.path().display()));
    }
    let limited: Vec<_> = frames.parts().iter().filter(|part| part.limited).collect();
    if let Some(first) = limited.first() {
        let files =
            if limited.len() == 1 { String::new() } else { format!(" and {}", count(limited.len() - 1, "more file")) };
        notes.push(format!(
            "{}{files}: values run from 16 to 235 where the camera had 0 to 255, since the video is coded for the \
             eye; they are used as they are: (value - 16) x 255 / 219 gives those of the camera. Record without loss \
             (GREY, FFV1) if you can",
            first.path.display()
        ));
    }
    notes
}

/// Which part of a coloured video is taken.
pub(super) fn on_colours(frames: &FrameReader) -> Option<String> {
    let coloured = |part: &&crate::stack::Part| part.taken_of_colours.is_some();
    let part = frames.parts().iter().find(coloured)?;
    let taken = part.taken_of_colours?;
    Some(format!("{}: the video is coded with colours; its {taken} is taken, unchanged", part.path.display()))
}
