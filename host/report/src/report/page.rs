//! The frame of the page around the sections.

use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = include_str!("style.css");

/// A part of the page.
pub struct Section {
    /// Name in links.
    pub id: &'static str,
    /// Heading.
    pub title: &'static str,
    /// Content.
    pub content: Markup,
}

/// Returns the whole page.
pub fn page(title: &str, head: &Markup, sections: Vec<Section>) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                // Nothing is loaded, whatever the page contains.
                meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'";
                meta name="generator" content=(concat!("evcal ", env!("CARGO_PKG_VERSION")));
                title { (title) }
                // Keeps browsers from requesting an icon.
                link rel="icon" href="data:,";
                style { (PreEscaped(STYLE)) }
            }
            body {
                header {
                    (head)
                    nav aria-label="Sections" {
                        ul { @for section in &sections { li { a href=(format!("#{}", section.id)) { (section.title) } } } }
                    }
                }
                main {
                    @for section in &sections {
                        section id=(section.id) aria-labelledby=(format!("{}-heading", section.id)) {
                            h2 id=(format!("{}-heading", section.id)) { (section.title) }
                            (section.content)
                        }
                    }
                }
                footer.faint { "Written by evcal " (env!("CARGO_PKG_VERSION")) "." }
            }
        }
    };
    page.into_string()
}

/// Returns a table that scrolls horizontally if the page is narrow.
pub fn scrolling(label: &str, table: &Markup) -> Markup {
    html! { div.scroll role="region" aria-label=(label) tabindex="0" { (table) } }
}

/// Returns one figure of a list.
pub fn figure(name: &str, value: &str, explanation: &str) -> Markup {
    html! { div { dt { (name) } dd { strong { (value) } span { (explanation) } } } }
}
