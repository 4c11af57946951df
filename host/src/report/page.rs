//! The page: head, contents, numbered figures and tables.

use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = include_str!("style.css");

/// Counts figures and tables.
#[derive(Clone, Copy, Debug, Default)]
pub struct Numbers {
    figures: usize,
    tables: usize,
}

/// A chapter of the page.
#[derive(Clone, Debug)]
pub struct Section {
    /// Address within the page.
    pub id: &'static str,
    /// Heading.
    pub title: &'static str,
    /// What stands under it.
    pub body: Markup,
}

/// A figure of the key line: what it is, its value, and a word on it.
#[derive(Clone, Debug, Default)]
pub struct Key {
    /// What it is.
    pub name: String,
    /// Value.
    pub value: String,
    /// Unit.
    pub unit: &'static str,
    /// A word on it.
    pub note: String,
    /// Whether a target holds; None where there is none.
    pub holds: Option<bool>,
}

impl Numbers {
    /// A numbered figure with its caption: a bold title, then a text.
    pub fn figure(&mut self, title: &str, text: &str, body: Markup) -> Markup {
        self.figures += 1;
        html! {
            figure {
                (body)
                figcaption { b { "Fig. " (self.figures) " | " (title) } " " (text) }
            }
        }
    }

    /// A numbered table with its caption; `rows` holds `thead` and `tbody`.
    pub fn table(&mut self, title: &str, text: &str, rows: Markup) -> Markup {
        self.tables += 1;
        html! {
            div.scroll {
                table {
                    caption { b { "Table " (self.tables) " | " (title) } " " (text) }
                    (rows)
                }
            }
        }
    }
}

/// Two columns: a name and its value.
pub fn pairs(rows: &[(String, Markup)]) -> Markup {
    html! {
        tbody { @for (name, value) in rows { tr { td { (name) } td.n { (value) } } } }
    }
}

/// The line of key figures.
pub fn keys(keys: &[Key]) -> Markup {
    html! {
        dl.keys {
            @for key in keys {
                div {
                    dt { (key.name) }
                    dd.verdict.holds[key.holds == Some(true)].fails[key.holds == Some(false)] {
                        (key.value) @if !key.unit.is_empty() { " " small { (key.unit) } }
                    }
                    @if !key.note.is_empty() { div.note { (key.note) } }
                }
            }
        }
    }
}

/// The whole document.
pub fn document(title: &str, lead: &str, key_figures: &[Key], sections: &[Section]) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width,initial-scale=1";
                meta name="generator" content=(concat!("ommatidia ", env!("CARGO_PKG_VERSION")));
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                header.top {
                    div.brand { "Ommatidia" }
                    h1 { (title) }
                    p.lead { (lead) }
                    @if sections.len() > 1 {
                        nav.contents aria-label="Contents" {
                            @for s in sections { a href={ "#" (s.id) } { (s.title) } }
                        }
                    }
                    @if !key_figures.is_empty() { (keys(key_figures)) }
                }
                main {
                    @for s in sections { section id=(s.id) { h2 { (s.title) } (s.body) } }
                }
                footer { "Rendered by ommatidia " (env!("CARGO_PKG_VERSION")) " from the artifacts listed under Provenance. "
                    "The page holds all of its data and asks the network for nothing." }
            }
        }
    }
    .into_string()
}
