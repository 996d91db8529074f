//! Tables that can be written as Markdown and HTML.

use std::fmt::Write;

use crate::html;

/// A table of text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    /// What it shows.
    pub title: String,
    /// Remarks below it.
    pub note: String,
    /// Names of the columns.
    pub header: Vec<String>,
    /// The rows, each as long as the header.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// The table in Markdown, with its title as a heading.
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| {
            format!("| {} |\n", cells.iter().map(|c| c.replace('|', "\\|")).collect::<Vec<_>>().join(" | "))
        };
        let mut text = format!("## {}\n\n{}", self.title, line(&self.header));
        let rule: Vec<String> =
            (0..self.header.len()).map(|i| if i == 0 { "---" } else { "---:" }.to_owned()).collect();
        text += &line(&rule);
        for row in &self.rows {
            text += &line(row);
        }
        if !self.note.is_empty() {
            // Writing to a string cannot fail.
            let _ = write!(text, "\n{}\n", self.note);
        }
        text + "\n"
    }

    /// The table in HTML, as a section.
    pub fn html(&self) -> String {
        let note = if self.note.is_empty() { String::new() } else { format!("<p>{}</p>\n", html::escape(&self.note)) };
        html::section(&self.title, &(html::table(&self.header, &self.rows) + &note))
    }
}

/// A number with `decimals`, a dash where there is none.
pub fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or("–".to_owned(), |x| format!("{x:.decimals$}"))
}

/// A share as percentage, a dash where there is none.
pub fn percent(share: Option<f64>) -> String {
    share.map_or("–".to_owned(), |x| format!("{:.1} %", 100.0 * x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_hold_every_cell() {
        let table = Table {
            title: "T".into(),
            note: "n".into(),
            header: vec!["a".into(), "b".into()],
            rows: vec![vec!["x|y".into(), number(None, 2)], vec!["z".into(), percent(Some(0.5))]],
        };
        assert_eq!(table.markdown(), "## T\n\n| a | b |\n| --- | ---: |\n| x\\|y | – |\n| z | 50.0 % |\n\nn\n\n");
        assert!(table.html().contains(">50.0 %</td>"));
    }
}
