//! A table as people read it: rows of cells with a heading, as aligned text, Markdown or HTML.

use crate::svg::escaped;
use std::fmt::Write;

/// A column's heading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Column {
    /// What stands in it.
    pub name: &'static str,
    /// In what unit; empty without one.
    pub unit: &'static str,
}

/// A table of finished cells. Rows are grouped in blocks, and rules stand between blocks.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Heading.
    pub title: String,
    /// Columns from left to right.
    pub columns: Vec<Column>,
    /// How many columns from the left hold words; the others hold numbers and are aligned to the right.
    pub words: usize,
    /// Blocks of rows of cells.
    pub blocks: Vec<Vec<Vec<String>>>,
    /// What a reader must know to read it.
    pub note: String,
}

impl Grid {
    fn rows(&self) -> impl Iterator<Item = &Vec<String>> {
        self.blocks.iter().flatten()
    }

    /// Aligned with spaces, for a terminal.
    pub fn to_text(&self) -> String {
        let unit = |column: &Column| {
            if column.unit.is_empty() { String::new() } else { format!("[{}]", column.unit) }
        };
        let names: Vec<String> = self.columns.iter().map(|c| c.name.to_owned()).collect();
        let units: Vec<String> = self.columns.iter().map(unit).collect();
        let length = |cell: &String| cell.chars().count();
        let widths: Vec<usize> = (0..self.columns.len())
            .map(|i| {
                self.rows()
                    .chain([&names, &units])
                    .filter_map(|row| row.get(i))
                    .map(length)
                    .max()
                    .unwrap_or(0)
            })
            .collect();
        let aligned = |row: &Vec<String>| {
            let mut line = String::new();
            for (i, (cell, &width)) in row.iter().zip(&widths).enumerate() {
                let gap = if i == 0 { "" } else { "  " };
                let _ = if i < self.words {
                    write!(line, "{gap}{cell:<width$}")
                } else {
                    write!(line, "{gap}{cell:>width$}")
                };
            }
            line.trim_end().to_owned()
        };
        let whole = widths.iter().sum::<usize>() + 2 * widths.len().saturating_sub(1);
        let rule = "-".repeat(whole);
        let mut lines = vec![self.title.clone(), String::new(), aligned(&names)];
        if units.iter().any(|unit| !unit.is_empty()) {
            lines.push(aligned(&units));
        }
        for block in &self.blocks {
            lines.push(rule.clone());
            lines.extend(block.iter().map(aligned));
        }
        lines.extend([String::new(), wrapped(&self.note, whole), String::new()]);
        lines.join("\n")
    }

    /// GitHub's Markdown.
    pub fn to_markdown(&self) -> String {
        let heading = |column: &Column| match column.unit {
            "" => column.name.to_owned(),
            unit => format!("{} [{unit}]", column.name),
        };
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let mut text = format!("### {}\n\n", self.title);
        text += &line(self.columns.iter().map(heading).collect());
        text += &line(
            (0..self.columns.len()).map(|i| if i < self.words { "---" } else { "---:" }.to_owned()).collect(),
        );
        for row in self.rows() {
            text += &line(row.iter().map(|cell| cell.replace('|', "\\|")).collect());
        }
        text + "\n" + &self.note + "\n"
    }

    /// A `<figure>` with a `<table>`.
    pub fn to_html(&self) -> String {
        let mut html =
            format!("<figure class=\"table\">\n<figcaption>{}</figcaption>\n", escaped(&self.title));
        html += "<div class=\"scroll\"><table>\n<thead><tr>";
        for (i, column) in self.columns.iter().enumerate() {
            let class = if i < self.words { " class=\"word\"" } else { "" };
            let _ =
                write!(html, "<th{class}>{}<span>{}</span></th>", escaped(column.name), escaped(column.unit));
        }
        html += "</tr></thead>\n";
        for block in &self.blocks {
            html += "<tbody>\n";
            for row in block {
                html += "<tr>";
                for (i, cell) in row.iter().enumerate() {
                    let class = if i < self.words { " class=\"word\"" } else { "" };
                    let _ = write!(html, "<td{class}>{}</td>", escaped(cell));
                }
                html += "</tr>\n";
            }
            html += "</tbody>\n";
        }
        html + "</table></div>\n<p class=\"note\">" + &escaped(&self.note) + "</p>\n</figure>\n"
    }
}

/// Text broken at spaces into lines of at most `width` characters, where its words allow it.
fn wrapped(text: &str, width: usize) -> String {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let line = lines.len() - 1;
        if !lines[line].is_empty() && lines[line].chars().count() + 1 + word.chars().count() > width {
            lines.push(word.to_owned());
        } else {
            if !lines[line].is_empty() {
                lines[line].push(' ');
            }
            lines[line].push_str(word);
        }
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::svg::tests::assert_balanced;

    fn grid() -> Grid {
        Grid {
            title: "T < 1".into(),
            columns: vec![Column { name: "system", unit: "" }, Column { name: "Δx", unit: "mm" }],
            words: 1,
            blocks: vec![vec![vec!["a|b".into(), "1.72".into()]], vec![vec!["é".into(), "10.00".into()]]],
            note: "n & m".into(),
        }
    }

    #[test]
    fn text_is_aligned_by_characters_not_bytes() {
        let expected = "T < 1\n\nsystem     Δx\n         [mm]\n-------------\na|b      1.72\n-------------\né       10.00\n\nn & m\n";
        assert_eq!(grid().to_text(), expected);
    }

    #[test]
    fn notes_are_broken_between_words() {
        assert_eq!(wrapped("one two three", 8), "one two\nthree");
        assert_eq!(wrapped("unbreakable a", 4), "unbreakable\na");
        let without_units = Grid { columns: vec![Column { name: "a", unit: "" }; 2], ..grid() };
        assert_eq!(without_units.to_text().lines().nth(3), Some("----------"));
    }

    #[test]
    fn markdown_escapes_its_bars() {
        let expected =
            "### T < 1\n\n| system | Δx [mm] |\n| --- | ---: |\n| a\\|b | 1.72 |\n| é | 10.00 |\n\nn & m\n";
        assert_eq!(grid().to_markdown(), expected);
    }

    #[test]
    fn html_is_well_formed_and_escaped() {
        let html = grid().to_html();
        assert_balanced(&html);
        assert!(html.contains("T &lt; 1") && html.contains("<td>10.00</td>") && html.contains("n &amp; m"));
    }
}
