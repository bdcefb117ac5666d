//! The frame of the page around the sections.

use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = include_str!("style.css");

/// A section of the page.
pub struct Section {
    /// Anchor of links to the section.
    pub id: &'static str,
    /// Heading.
    pub title: &'static str,
    /// `true` if the section stays closed until the reader opens it; a printed page shows its content.
    pub folded: bool,
    /// Content.
    pub content: Markup,
}

/// Returns the page: the open sections first, then the folded ones.
pub fn page(title: &str, head: &Markup, sections: Vec<Section>) -> String {
    let (folded, open): (Vec<Section>, Vec<Section>) = sections.into_iter().partition(|section| section.folded);
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                // The browser loads nothing, whatever the page contains.
                meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'";
                meta name="generator" content=(concat!("evcal ", env!("CARGO_PKG_VERSION")));
                title { (title) }
                // An empty icon keeps browsers from requesting one.
                link rel="icon" href="data:,";
                style { (PreEscaped(STYLE)) }
            }
            body {
                header {
                    (head)
                    nav aria-label="Sections" {
                        ul { @for section in open.iter().chain(&folded) { li { a href=(format!("#{}", section.id)) { (section.title) } } } }
                    }
                }
                main {
                    @for section in &open {
                        section id=(section.id) aria-labelledby=(heading(section)) {
                            h2 id=(heading(section)) { (section.title) }
                            (section.content)
                        }
                    }
                    @for section in &folded {
                        section aria-labelledby=(heading(section)) {
                            details {
                                summary { h2 id=(heading(section)) { (section.title) } }
                                // Browsers open the details when a link leads into them.
                                div.inside id=(section.id) { (section.content) }
                            }
                        }
                    }
                }
                footer.faint { "Written by evcal " (env!("CARGO_PKG_VERSION")) "." }
            }
        }
    };
    page.into_string()
}

fn heading(section: &Section) -> String {
    format!("{}-heading", section.id)
}

/// Returns a table that scrolls by itself if the page is narrower.
pub fn scrolling(label: &str, table: &Markup) -> Markup {
    html! { div.scroll role="region" aria-label=(label) tabindex="0" { (table) } }
}

/// Returns an entry of the list of figures at the top.
pub fn figure(name: &str, value: &str, explanation: &str) -> Markup {
    html! { div { dt { (name) } dd { strong { (value) } span { (explanation) } } } }
}
