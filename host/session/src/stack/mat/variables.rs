//! Which array of a .mat file holds the frames.

use super::KIND;
use crate::error::SessionError;
use std::path::Path;

/// Most variables that are listed in a message.
const MOST_LISTED: usize = 12;

/// What a .mat file says of one variable.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Variable {
    pub name: String,
    /// MATLAB's name of its class, e.g. `uint16`.
    pub class: String,
    /// Size, (rows, cols, ...).
    pub size: Vec<u64>,
    /// Whether it is an array of numbers.
    pub numeric: bool,
}

impl Variable {
    fn text(&self) -> String {
        let size: Vec<String> = self.size.iter().map(u64::to_string).collect();
        if size.is_empty() {
            return format!("{} ({})", self.name, self.class);
        }
        format!("{} ({}, {})", self.name, size.join(" x "), self.class)
    }

    /// Its size as [frames, rows, cols]; a matrix that was named is one frame.
    pub fn shape(&self, path: &Path) -> Result<[usize; 3], SessionError> {
        let axes: Vec<usize> = self.size.iter().filter_map(|n| usize::try_from(*n).ok()).collect();
        match *axes.as_slice() {
            [rows, cols, frames] => Ok([frames, rows, cols]),
            [rows, cols] => Ok([1, rows, cols]),
            _ => Err(SessionError::Shape {
                path: path.into(),
                expected: format!("`{}` of size (rows, cols, frames)", self.name),
                found: format!("{:?}", self.size),
                remedy: "save one grey movie as an array of three axes, frames last",
            }),
        }
    }
}

/// The index of the variable with the given name, or of the only array of numbers with three axes.
pub(super) fn choose(path: &Path, variables: &[Variable], wanted: Option<&str>) -> Result<usize, SessionError> {
    let mut listed: Vec<String> = variables.iter().take(MOST_LISTED).map(Variable::text).collect();
    if variables.len() > MOST_LISTED {
        listed.push(format!("and {} more", variables.len() - MOST_LISTED));
    }
    let listed = if listed.is_empty() { "none".into() } else { listed.join(", ") };
    let remedy = "choose one with `import --variable NAME`, and give the session to other verbs";
    if let Some(name) = wanted {
        let Some(at) = variables.iter().position(|v| v.name == name) else {
            let field = format!("variable `{name}`");
            return Err(SessionError::Missing { path: path.into(), field, found: listed, remedy });
        };
        if !variables[at].numeric {
            let found = format!("class {}", variables[at].class);
            return Err(SessionError::format(path, KIND, format!("`{name}` is no array of numbers: {found}")));
        }
        return Ok(at);
    }
    let movies: Vec<usize> = (0..variables.len()).filter(|i| is_movie(&variables[*i])).collect();
    match movies.as_slice() {
        [one] => Ok(*one),
        _ => {
            let remedy = if movies.is_empty() { "save such an array" } else { remedy };
            let expected = "one array of numbers of size (rows, cols, frames)";
            Err(SessionError::value(path, "variables", expected, listed, remedy))
        }
    }
}

fn is_movie(variable: &Variable) -> bool {
    variable.numeric && variable.size.len() == 3
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn variable(name: &str, size: &[u64], numeric: bool) -> Variable {
        Variable { name: name.into(), class: "uint8".into(), size: size.into(), numeric }
    }

    #[test]
    fn the_only_movie_is_chosen_and_of_several_the_named_one() {
        let path = Path::new("x.mat");
        let mut all = vec![variable("fs", &[1, 1], true), variable("Y", &[4, 5, 6], true)];
        assert_eq!(choose(path, &all, None).unwrap(), 1);
        assert_eq!(all[1].shape(path).unwrap(), [6, 4, 5]);
        all.push(variable("dark", &[4, 5, 2], true));
        let error = choose(path, &all, None).unwrap_err().to_string();
        assert!(error.contains("Y (4 x 5 x 6, uint8), dark (4 x 5 x 2, uint8)"), "{error}");
        assert!(error.contains("--variable NAME"), "{error}");
        assert_eq!(choose(path, &all, Some("dark")).unwrap(), 2);
        // A matrix is a frame where it is named.
        assert_eq!(choose(path, &all, Some("fs")).unwrap(), 0);
        assert_eq!(all[0].shape(path).unwrap(), [1, 1, 1]);
        let error = choose(path, &all, Some("y")).unwrap_err().to_string();
        assert!(error.contains("variable `y`") && error.contains("Y (4 x 5 x 6"), "{error}");
        let error = choose(path, &[variable("s", &[1, 1, 2], false)], None).unwrap_err().to_string();
        assert!(error.contains("one array of numbers") && error.contains("save such an array"), "{error}");
        let error = choose(path, &[variable("g", &[], false)], None).unwrap_err().to_string();
        assert!(error.contains("found g (uint8);"), "{error}");
        let many = vec![variable("a", &[1, 1], true); 20];
        assert!(choose(path, &many, None).unwrap_err().to_string().contains("and 8 more"));
    }
}
