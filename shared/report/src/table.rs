//! Tables with figures that stand under each other.

use std::fmt::Write as _;

use crate::escape;

/// A table of text. A column whose cells all begin like numbers stands to the right.
#[derive(Clone, Debug, Default)]
pub struct Table {
    columns: Vec<String>,
    rows: Vec<Row>,
}

#[derive(Clone, Debug)]
struct Row {
    cells: Vec<String>,
    class: &'static str,
}

impl Table {
    /// A table with these column heads.
    #[must_use]
    pub fn new<S: Into<String>>(columns: impl IntoIterator<Item = S>) -> Self {
        Self { columns: columns.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// Adds a row. Missing cells are left empty, surplus ones are dropped.
    pub fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) {
        self.push(cells, "");
    }

    /// Adds a row that stands out: the one the reader came for.
    pub fn strong_row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) {
        self.push(cells, " class=\"strong\"");
    }

    /// Adds a row that stands back: figures of others, set beside ours.
    pub fn quoted_row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) {
        self.push(cells, " class=\"quoted\"");
    }

    fn push<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>, class: &'static str) {
        let mut cells: Vec<String> = cells.into_iter().map(Into::into).collect();
        cells.resize(self.columns.len(), String::new());
        self.rows.push(Row { cells, class });
    }

    /// Whether a column stands to the right.
    fn is_numeric(&self, column: usize) -> bool {
        let mut cells = self.rows.iter().map(|row| row.cells[column].trim()).filter(|cell| !is_empty(cell)).peekable();
        cells.peek().is_some()
            && cells.all(|cell| {
                cell.trim_start_matches(['+', '-', '\u{2212}', '<', '>', '~']).starts_with(|c: char| c.is_ascii_digit())
            })
    }

    /// The table as HTML.
    #[must_use]
    pub fn to_html(&self) -> String {
        let class: Vec<_> =
            (0..self.columns.len()).map(|column| if self.is_numeric(column) { " class=\"n\"" } else { "" }).collect();
        let mut html = String::from("<div class=\"scroll\"><table>\n<thead><tr>");
        for (head, class) in self.columns.iter().zip(&class) {
            let _ = write!(html, "<th{class}>{}</th>", escape(head));
        }
        html.push_str("</tr></thead>\n<tbody>\n");
        for row in &self.rows {
            let _ = write!(html, "<tr{}>", row.class);
            for (cell, class) in row.cells.iter().zip(&class) {
                let _ = write!(html, "<td{class}>{}</td>", escape(cell));
            }
            html.push_str("</tr>\n");
        }
        html.push_str("</tbody>\n</table></div>\n");
        html
    }
}

/// A cell that says there is no figure.
fn is_empty(cell: &str) -> bool {
    matches!(cell, "" | "-" | "\u{2013}" | "n/a")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_stand_to_the_right_and_text_to_the_left() {
        let mut table = Table::new(["method", "c", "time"]);
        table.row(["walle", "1.40", "-"]);
        table.strong_row(["<best>", "-0.3 %", "12 us"]);
        table.quoted_row(["short"]);
        assert_eq!([0, 1, 2].map(|column| table.is_numeric(column)), [false, true, true]);
        let html = table.to_html();
        assert!(html.contains("<td>&lt;best&gt;</td><td class=\"n\">-0.3 %</td>"), "{html}");
        assert!(html.contains("<tr class=\"quoted\"><td>short</td><td class=\"n\"></td>"), "{html}");
        assert!(!Table::new(["a"]).is_numeric(0));
    }
}
