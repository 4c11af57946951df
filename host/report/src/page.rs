//! The page: head, contents, numbered figures and tables.

use maud::{DOCTYPE, Markup, PreEscaped, html};

/// The style sheet of a report; the browser's view uses the same.
pub const STYLE: &str = include_str!("style.css");

/// Numbers figures and tables.
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
    pub title: String,
    /// Content.
    pub body: Markup,
}

/// A key figure at the top of the page: name, value and note.
#[derive(Clone, Debug, Default)]
pub struct Key {
    /// Name.
    pub name: String,
    /// Value.
    pub value: String,
    /// Unit; may be empty.
    pub unit: &'static str,
    /// A note under the value; may be empty.
    pub note: String,
    /// Whether the target is met; None without a target.
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
            div.tabled {
                // Not a `caption`: that would be cut off where the table is wider than the page and scrolls.
                p.caption id={ "table-" (self.tables) } { b { "Table " (self.tables) " | " (title) } " " (text) }
                div.scroll { table aria-describedby={ "table-" (self.tables) } { (rows) } }
            }
        }
    }
}

/// Two columns: a name and its value.
pub fn pairs(rows: &[(String, Markup)]) -> Markup {
    html! {
        tbody { @for (name, value) in rows { tr { td { (name) } td.v { (value) } } } }
    }
}

/// The key figures.
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
                footer { "Rendered by ommatidia " (env!("CARGO_PKG_VERSION")) " from the artifacts listed under \
                    Provenance. "
                    "The page is self-contained and loads nothing from the internet." }
            }
        }
    }
    .into_string()
}
