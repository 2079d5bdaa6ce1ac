//! A table of finished cells, as aligned text or Markdown.

use std::fmt::Write;

/// Heading of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Column {
    /// Quantity.
    pub name: &'static str,
    /// Unit; empty if there is none.
    pub unit: &'static str,
}

/// A table of finished cells. Its rows are grouped into blocks with rules between them.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Title above the table.
    pub title: String,
    /// Columns from left to right.
    pub columns: Vec<Column>,
    /// Number of columns on the left that hold text. The others hold numbers and are aligned to the right.
    pub text_columns: usize,
    /// Blocks of rows of cells.
    pub blocks: Vec<Vec<Vec<String>>>,
    /// Explanations below the table.
    pub note: String,
}

impl Table {
    fn rows(&self) -> impl Iterator<Item = &Vec<String>> {
        self.blocks.iter().flatten()
    }

    /// Returns the table aligned with spaces, for a terminal.
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
                let _ = if i < self.text_columns {
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

    /// Returns the table in GitHub's Markdown.
    pub fn to_markdown(&self) -> String {
        let heading = |column: &Column| match column.unit {
            "" => column.name.to_owned(),
            unit => format!("{} [{unit}]", column.name),
        };
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let mut text = format!("### {}\n\n", self.title);
        text += &line(self.columns.iter().map(heading).collect());
        text += &line(
            (0..self.columns.len())
                .map(|i| if i < self.text_columns { "---" } else { "---:" }.to_owned())
                .collect(),
        );
        for row in self.rows() {
            text += &line(row.iter().map(|cell| cell.replace('|', "\\|")).collect());
        }
        text + "\n" + &self.note + "\n"
    }
}

/// Breaks text at spaces into lines of at most `width` characters. A longer word gets a line of its own.
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

    fn table() -> Table {
        Table {
            title: "T < 1".into(),
            columns: vec![Column { name: "system", unit: "" }, Column { name: "Δx", unit: "mm" }],
            text_columns: 1,
            blocks: vec![vec![vec!["a|b".into(), "1.72".into()]], vec![vec!["é".into(), "10.00".into()]]],
            note: "n & m".into(),
        }
    }

    #[test]
    fn text_is_aligned_by_characters_not_bytes() {
        let expected = "T < 1\n\nsystem     Δx\n         [mm]\n-------------\na|b      1.72\n-------------\né       10.00\n\nn & m\n";
        assert_eq!(table().to_text(), expected);
    }

    #[test]
    fn notes_are_broken_between_words() {
        assert_eq!(wrapped("one two three", 8), "one two\nthree");
        assert_eq!(wrapped("unbreakable a", 4), "unbreakable\na");
        let without_units = Table { columns: vec![Column { name: "a", unit: "" }; 2], ..table() };
        assert_eq!(without_units.to_text().lines().nth(3), Some("----------"));
    }

    #[test]
    fn markdown_escapes_its_bars() {
        let expected =
            "### T < 1\n\n| system | Δx [mm] |\n| --- | ---: |\n| a\\|b | 1.72 |\n| é | 10.00 |\n\nn & m\n";
        assert_eq!(table().to_markdown(), expected);
    }
}
