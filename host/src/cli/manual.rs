//! `completions` and `man`: generated from the same description as `--help`.

use super::common::Outcome;
use anyhow::Context;
use clap::Command;
use clap_complete::Shell;

/// Options of `completions`.
#[derive(Debug, clap::Args)]
pub struct Completions {
    /// The shell
    shell: Shell,
}

/// Options of `man`.
#[derive(Debug, clap::Args)]
pub struct Man {}

/// The completions of a shell.
///
/// # Errors
/// None: the signature is that of every verb.
pub fn completions(args: &Completions, mut command: Command) -> anyhow::Result<Outcome> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, "ommatidia", &mut text);
    outcome(args.shell.to_string(), text)
}

/// The manual page: the program, then each verb.
///
/// # Errors
/// None: the signature is that of every verb.
pub fn man(_args: &Man, mut command: Command) -> anyhow::Result<Outcome> {
    command.build();
    let mut text = Vec::new();
    clap_mangen::Man::new(command.clone()).render(&mut text).context("manual page")?;
    for verb in command.get_subcommands().filter(|v| !v.is_hide_set() && v.get_name() != "help") {
        let page = clap_mangen::Man::new(verb.clone());
        page.render_synopsis_section(&mut text).context("manual page")?;
        page.render_description_section(&mut text).context("manual page")?;
        page.render_options_section(&mut text).context("manual page")?;
    }
    outcome("man".into(), text)
}

fn outcome(kind: String, text: Vec<u8>) -> anyhow::Result<Outcome> {
    let text = String::from_utf8(text).context("generated text")?;
    Ok(Outcome { json: serde_json::json!({ "kind": kind, "text": text }), text })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::cli::Cli;
    use clap::CommandFactory;

    #[test]
    fn the_manual_names_every_verb() {
        let text = man(&Man {}, Cli::command()).unwrap().text;
        for verb in ["demo", "bench", "calibrate", "simulate", "train", "quantize", "reconstruct", "evaluate"] {
            assert!(text.contains(verb), "{verb} is missing");
        }
    }

    #[test]
    fn completions_know_the_verbs() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let text = completions(&Completions { shell }, Cli::command()).unwrap().text;
            assert!(text.contains("reconstruct"), "{shell}");
        }
    }
}
