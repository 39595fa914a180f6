//! A page that is one file.

use std::fmt::Write as _;

use crate::{Table, escape};

/// A self-contained HTML page, built from top to bottom.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    body: String,
}

impl Page {
    /// A page with this title and one line that says what it shows.
    #[must_use]
    pub fn new(title: &str, about: &str) -> Self {
        let body = format!("<header><h1>{}</h1><p>{}</p></header>\n", escape(title), escape(about));
        Self { title: escape(title), body }
    }

    /// Begins a section.
    pub fn section(&mut self, heading: &str) {
        let _ = writeln!(self.body, "<h2>{}</h2>", escape(heading));
    }

    /// Adds a paragraph.
    pub fn text(&mut self, text: &str) {
        let _ = writeln!(self.body, "<p>{}</p>", escape(text));
    }

    /// Adds the few figures that matter most, large: what, and how much.
    pub fn facts<'a>(&mut self, facts: impl IntoIterator<Item = (&'a str, String)>) {
        self.body.push_str("<dl class=\"facts\">\n");
        for (what, value) in facts {
            let _ = writeln!(self.body, "<div><dt>{}</dt><dd>{}</dd></div>", escape(what), escape(&value));
        }
        self.body.push_str("</dl>\n");
    }

    /// Adds a table.
    pub fn table(&mut self, table: &Table) {
        self.body.push_str(&table.to_html());
    }

    /// Adds an SVG picture of this crate with a caption.
    pub fn figure(&mut self, svg: &str, caption: &str) {
        let _ = writeln!(self.body, "<figure>{svg}<figcaption>{}</figcaption></figure>", escape(caption));
    }

    /// Adds SVG pictures of this crate with their captions, side by side as far as there is room.
    pub fn gallery(&mut self, figures: impl IntoIterator<Item = (String, String)>) {
        self.push_gallery("gallery", figures);
    }

    /// As [`Page::gallery`], for charts, which need more room each.
    pub fn gallery_wide(&mut self, figures: impl IntoIterator<Item = (String, String)>) {
        self.push_gallery("gallery wide", figures);
    }

    fn push_gallery(&mut self, class: &str, figures: impl IntoIterator<Item = (String, String)>) {
        let _ = writeln!(self.body, "<div class=\"{class}\">");
        for (svg, caption) in figures {
            self.figure(&svg, &caption);
        }
        self.body.push_str("</div>\n");
    }

    /// The page as HTML.
    #[must_use]
    pub fn to_html(&self) -> String {
        let Self { title, body } = self;
        format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n{body}</main>\n</body>\n</html>\n"
        )
    }
}

const STYLE: &str = include_str!("page.css");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_whole_and_calls_nobody() {
        let mut page = Page::new("Shift <1>", "what & why");
        page.section("Results");
        page.text("a < b");
        page.facts([("boxes", "310".to_owned())]);
        page.table(&Table::new(["a"]));
        page.gallery([("<svg></svg>".to_owned(), "container 0".to_owned())]);
        let html = page.to_html();
        assert!(html.starts_with("<!doctype html>") && html.ends_with("</html>\n"));
        assert!(html.contains("<title>Shift &lt;1&gt;</title>") && html.contains("<p>a &lt; b</p>"));
        for outside in ["http:", "https:", "url(", "<script", "@import"] {
            assert!(!html.contains(outside), "{outside}");
        }
    }
}
