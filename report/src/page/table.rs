//! A table of results as HTML.

use crate::drawing::markup::escaped;
use eval::results::table::Table;
use std::fmt::Write;

/// Returns a table as a `<figure>` with a `<table>`.
pub(super) fn to_html(table: &Table) -> String {
    let mut html = format!("<figure class=\"table\">\n<figcaption>{}</figcaption>\n", escaped(&table.title));
    html += "<div class=\"scroll\"><table>\n<thead><tr>";
    for (i, column) in table.columns.iter().enumerate() {
        let class = if i < table.text_columns { " class=\"word\"" } else { "" };
        let _ = write!(html, "<th{class}>{}<span>{}</span></th>", escaped(column.name), escaped(column.unit));
    }
    html += "</tr></thead>\n";
    for block in &table.blocks {
        html += "<tbody>\n";
        for row in block {
            html += "<tr>";
            for (i, cell) in row.iter().enumerate() {
                let class = if i < table.text_columns { " class=\"word\"" } else { "" };
                let _ = write!(html, "<td{class}>{}</td>", escaped(cell));
            }
            html += "</tr>\n";
        }
        html += "</tbody>\n";
    }
    html + "</table></div>\n<p class=\"note\">" + &escaped(&table.note) + "</p>\n</figure>\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::markup::tests::assert_balanced;
    use eval::results::table::Column;

    #[test]
    fn html_is_well_formed_and_escaped() {
        let html = to_html(&Table {
            title: "T < 1".into(),
            columns: vec![Column { name: "system", unit: "" }, Column { name: "Δx", unit: "mm" }],
            text_columns: 1,
            blocks: vec![vec![vec!["a|b".into(), "10.00".into()]]],
            note: "n & m".into(),
        });
        assert_balanced(&html);
        assert!(html.contains("T &lt; 1") && html.contains("<td>10.00</td>") && html.contains("n &amp; m"));
    }
}
