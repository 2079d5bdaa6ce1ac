//! SVG documents with the few elements that the figures need, in one style.

use super::markup::escaped;
use datagen::Result;
use image::RgbImage;
use std::fmt::Write;

/// Color of text and axes.
pub const INK: &str = "#1a1a1a";
/// Color of secondary text and lines.
pub const MUTED: &str = "#666666";
/// Color of grid lines and frames.
pub const FAINT: &str = "#dddddd";
/// Line colors that color-blind readers can distinguish (Okabe and Ito, "Color Universal Design").
pub const PALETTE: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

/// Horizontal alignment of a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// The text begins at its point.
    Start,
    /// The text is centered at its point.
    Middle,
    /// The text ends at its point.
    End,
}

/// Style of a text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextStyle {
    /// Font size.
    pub size: f64,
    /// Horizontal alignment.
    pub anchor: Anchor,
    /// Color.
    pub color: &'static str,
    /// Whether it is bold.
    pub bold: bool,
}

impl TextStyle {
    /// Style of labels of axes and panels.
    pub const LABEL: Self = Self { size: 15.0, anchor: Anchor::Middle, color: INK, bold: false };
    /// Style of numbers at ticks.
    pub const TICK: Self = Self { size: 13.0, anchor: Anchor::Middle, color: MUTED, bold: false };
    /// Style of headings of panels.
    pub const HEADING: Self = Self { size: 16.0, anchor: Anchor::Middle, color: INK, bold: true };

    /// Returns the style with another alignment.
    #[must_use]
    pub fn anchored(self, anchor: Anchor) -> Self {
        Self { anchor, ..self }
    }
}

/// Style of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    /// Color.
    pub color: &'static str,
    /// Width.
    pub width: f64,
    /// Whether it is dashed.
    pub dashed: bool,
}

/// An axis-aligned rectangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Area {
    /// Left edge.
    pub x: f64,
    /// Upper edge.
    pub y: f64,
    /// Width.
    pub width: f64,
    /// Height.
    pub height: f64,
}

/// Length of an arrow's head.
const ARROW_HEAD: f64 = 8.0;

/// A drawing. The origin is its upper left corner, and y points down.
#[derive(Debug, Clone)]
pub struct Svg {
    text: String,
}

impl Svg {
    /// Creates an empty white drawing. Screen readers read `description`.
    pub fn new(width: f64, height: f64, description: &str) -> Self {
        let mut text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" \
             font-family=\"Helvetica, Arial, sans-serif\">\n<title>{}</title>\n",
            escaped(description)
        );
        text.push_str("<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n");
        Self { text }
    }

    fn push(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing to a String cannot fail.
        let _ = self.text.write_fmt(element);
        self.text.push('\n');
    }

    /// Draws a polyline.
    pub fn line(&mut self, points: &[[f64; 2]], stroke: &Stroke) {
        let mut path = String::new();
        for [x, y] in points {
            let _ = write!(path, "{x:.2},{y:.2} ");
        }
        let dash = if stroke.dashed { " stroke-dasharray=\"6 4\"" } else { "" };
        self.push(format_args!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{}\" stroke-linejoin=\"round\"{dash}/>",
            path.trim_end(),
            stroke.color,
            stroke.width
        ));
    }

    /// Draws a filled circle with a thin rim.
    pub fn disc(&mut self, [x, y]: [f64; 2], radius: f64, fill: &str, rim: &str) {
        self.push(format_args!(
            "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius:.2}\" fill=\"{fill}\" stroke=\"{rim}\" stroke-width=\"0.75\"/>"
        ));
    }

    /// Draws a circle without filling it.
    pub fn ring(&mut self, [x, y]: [f64; 2], radius: f64, stroke: &Stroke) {
        let Stroke { color, width, .. } = stroke;
        self.push(format_args!(
            "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius:.2}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{width}\"/>"
        ));
    }

    /// Draws an arrow with its tip at `to`. A white rim makes it visible on any image.
    pub fn arrow(&mut self, from: [f64; 2], to: [f64; 2], color: &str) {
        let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
        let length = dx.hypot(dy);
        // The head takes at most 70 % of a short arrow.
        let head = ARROW_HEAD.min(0.7 * length);
        let [ux, uy] = if length > 0.0 { [dx / length, dy / length] } else { [0.0, 0.0] };
        let at = |along: f64, aside: f64| {
            let back = along - length;
            format!("{:.2},{:.2}", to[0] + back * ux - aside * uy, to[1] + back * uy + aside * ux)
        };
        let (neck, half) = (length - head, 0.42 * head);
        let outline = [
            at(0.0, 0.6),
            at(neck, 0.9),
            at(neck, half),
            at(length, 0.0),
            at(neck, -half),
            at(neck, -0.9),
            at(0.0, -0.6),
        ];
        self.push(format_args!(
            "<polygon points=\"{}\" fill=\"{color}\" stroke=\"#ffffff\" stroke-width=\"1.4\" paint-order=\"stroke\" \
             stroke-linejoin=\"round\"/>",
            outline.join(" ")
        ));
    }

    /// Draws a filled rectangle.
    pub fn rectangle(&mut self, area: &Area, fill: &str) {
        let Area { x, y, width, height } = area;
        self.push(format_args!(
            "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"{fill}\"/>"
        ));
    }

    /// Draws a line of text with its baseline through `point`.
    pub fn text(&mut self, point: [f64; 2], text: &str, style: &TextStyle) {
        self.turned_text(point, 0.0, text, style);
    }

    /// Draws a line of text, turned clockwise by `turn` degrees about its point.
    pub fn turned_text(&mut self, [x, y]: [f64; 2], turn: f64, text: &str, style: &TextStyle) {
        let anchor = match style.anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let weight = if style.bold { " font-weight=\"600\"" } else { "" };
        let transform =
            if turn == 0.0 { String::new() } else { format!(" transform=\"rotate({turn} {x:.2} {y:.2})\"") };
        self.push(format_args!(
            "<text x=\"{x:.2}\" y=\"{y:.2}\" font-size=\"{}\" text-anchor=\"{anchor}\" fill=\"{}\"{weight}{transform}>{}</text>",
            style.size,
            style.color,
            escaped(text)
        ));
    }

    /// Draws an image over an area with a thin frame. The image is embedded as PNG and stretched if necessary.
    pub fn image(&mut self, area: &Area, image: &RgbImage) -> Result<()> {
        let Area { x, y, width, height } = area;
        let png = datagen::png::encode(image)?;
        self.push(format_args!(
            "<image x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" preserveAspectRatio=\"none\" \
             href=\"data:image/png;base64,{}\"/>",
            base64(&png)
        ));
        self.push(format_args!(
            "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"none\" stroke=\"{MUTED}\" stroke-width=\"0.75\"/>"
        ));
        Ok(())
    }

    /// Returns the finished document.
    pub fn finish(mut self) -> String {
        self.text.push_str("</svg>\n");
        self.text
    }
}

/// Encodes bytes in Base64 with padding (RFC 4648, Section 4).
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut result = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let byte = |i: usize| u32::from(chunk.get(i).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for digit in 0..4 {
            let index = (bits >> (18 - 6 * digit) & 63) as usize;
            result.push(if digit <= chunk.len() { char::from(ALPHABET[index]) } else { '=' });
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::markup::tests::assert_balanced;

    #[test]
    fn base64_matches_the_rfc() {
        let vectors = [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")];
        for (plain, encoded) in vectors {
            assert_eq!(base64(plain.as_bytes()), encoded);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xbf]), "+/+/");
    }

    #[test]
    fn the_tip_of_an_arrow_is_at_its_end() {
        for (to, tip) in
            [([13.0, 44.0], "13.00,44.00"), ([10.0, 40.5], "10.00,40.50"), ([10.0, 40.0], "10.00,40.00")]
        {
            let mut svg = Svg::new(100.0, 50.0, "arrow");
            svg.arrow([10.0, 40.0], to, INK);
            let text = svg.finish();
            let outline = text.split("points=\"").nth(1).unwrap().split('"').next().unwrap();
            assert_eq!(outline.split(' ').nth(3), Some(tip), "{outline}");
            assert!(!text.contains("NaN"));
        }
    }

    #[test]
    fn a_drawing_is_well_formed_with_any_text() {
        let mut svg = Svg::new(100.0, 50.0, "a < b & \"c\"");
        svg.line(&[[0.0, 0.0], [1.0, 1.0]], &Stroke { color: INK, width: 1.0, dashed: true });
        svg.turned_text([1.0, 2.0], -90.0, "</text><script>", &TextStyle::LABEL);
        svg.image(&Area { x: 0.0, y: 0.0, width: 4.0, height: 3.0 }, &RgbImage::new(4, 3)).unwrap();
        let text = svg.finish();
        assert_balanced(&text);
        assert!(!text.contains("<script>"));
        // Every PNG begins with these bytes.
        assert!(text.contains(&format!("base64,{}", &base64(b"\x89PNG\r\n\x1a\n")[..10])));
    }
}
