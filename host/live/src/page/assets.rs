//! Static files of the page.

/// A file with its type.
pub struct Asset {
    /// Path on the server.
    pub path: &'static str,
    /// MIME type.
    pub kind: &'static str,
    /// Content.
    pub content: &'static str,
}

const SCRIPT: &str = "text/javascript; charset=utf-8";

/// All files.
pub const ASSETS: &[Asset] = &[
    Asset { path: "/", kind: "text/html; charset=utf-8", content: include_str!("page.html") },
    Asset { path: "/page.css", kind: "text/css; charset=utf-8", content: include_str!("page.css") },
    Asset { path: "/page.js", kind: SCRIPT, content: include_str!("page.js") },
    Asset { path: "/picture.js", kind: SCRIPT, content: include_str!("picture.js") },
    Asset { path: "/panels.js", kind: SCRIPT, content: include_str!("panels.js") },
];
