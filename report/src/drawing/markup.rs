//! Text in SVG and HTML.

/// Escapes text for the content or an attribute of an XML or HTML element.
pub fn escaped(text: &str) -> String {
    let mut result = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => result.push_str("&amp;"),
            '<' => result.push_str("&lt;"),
            '>' => result.push_str("&gt;"),
            '"' => result.push_str("&quot;"),
            '\'' => result.push_str("&#39;"),
            other => result.push(other),
        }
    }
    result
}

#[cfg(test)]
pub(crate) mod tests {
    /// Panics unless all elements are closed in order.
    pub(crate) fn assert_balanced(markup: &str) {
        let mut open = Vec::new();
        for tag in markup.split('<').skip(1) {
            let tag = tag.split('>').next().unwrap();
            let name =
                tag.trim_start_matches('/').split(|c: char| c.is_whitespace() || c == '/').next().unwrap();
            let void = ["meta", "br", "!doctype", "img"].contains(&name.to_lowercase().as_str());
            if let Some(closed) = tag.strip_prefix('/') {
                assert_eq!(open.pop(), Some(closed), "closed out of order");
            } else if !tag.ends_with('/') && !void {
                open.push(name);
            }
        }
        assert!(open.is_empty(), "left open: {open:?}");
    }
}
