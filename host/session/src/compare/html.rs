//! Text of a page: escaped, numbers as people read them, tables.

use std::fmt::Write;

/// Text as it may stand in an element or in an attribute with quotes.
pub(super) fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // What HTML forbids.
            c if c.is_control() && !matches!(c, '\n' | '\t') => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}

/// Three digits that count.
pub(super) fn number(x: f64) -> String {
    let size = x.abs();
    if x == 0.0 {
        "0".to_owned()
    } else if !(1e-4..1e6).contains(&size) {
        format!("{x:.1e}")
    } else {
        let decimals = (2 - size.log10().floor() as i32).clamp(0, 6) as usize;
        format!("{x:.decimals$}")
    }
}

/// A round share with its unit, without digits that say nothing.
pub(super) fn round_percent(x: f64) -> String {
    let text = number(100.0 * x);
    let text = if text.contains('.') && !text.contains('e') {
        text.trim_end_matches('0').trim_end_matches('.')
    } else {
        &text
    };
    format!("{text} %")
}

/// What is not known, or does not make sense.
pub(super) const NONE: &str = "–";

/// A number, or a dash.
pub(super) fn or_dash(x: Option<f64>) -> String {
    x.map_or(NONE.to_owned(), number)
}

/// A table: first the column of names, then numbers.
pub(super) struct Table {
    html: String,
}

impl Table {
    /// With a caption, and titles with their units below them.
    pub fn new(caption: &str, titles: &[(&str, &str)]) -> Self {
        let mut html =
            format!("<div class=\"wide\"><table>\n<caption>{}</caption>\n<thead><tr>", escape(caption));
        for (title, unit) in titles {
            // Writing to a string does not fail.
            let _ = write!(html, "<th scope=\"col\">{}", escape(title));
            if !unit.is_empty() {
                let _ = write!(html, "<br><small>{}</small>", escape(unit));
            }
            html.push_str("</th>");
        }
        html.push_str("</tr></thead>\n<tbody>\n");
        Self { html }
    }

    /// A row: its names, then numbers.
    pub fn row(&mut self, names: &[&str], numbers: impl IntoIterator<Item = String>) {
        self.html.push_str("<tr>");
        for name in names {
            let _ = write!(self.html, "<th scope=\"row\">{}</th>", escape(name));
        }
        for number in numbers {
            let _ = write!(self.html, "<td>{}</td>", escape(&number));
        }
        self.html.push_str("</tr>\n");
    }

    pub fn finish(self) -> String {
        self.html + "</tbody>\n</table></div>\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_stays_text() {
        let escaped = escape("<script a=\"b\" c='d'>&amp;\u{1}\n</script>");
        assert_eq!(escaped, "&lt;script a=&quot;b&quot; c=&#39;d&#39;&gt;&amp;amp;\u{fffd}\n&lt;/script&gt;");
        let mut table = Table::new("<b>", &[("<i>", "<u>")]);
        table.row(&["<x>"], ["<y>".to_owned()]);
        let html = table.finish();
        assert!(["<b>", "<i>", "<u>", "<x>", "<y>"].iter().all(|tag| !html.contains(tag)), "{html}");
    }

    #[test]
    fn numbers_have_three_digits() {
        let cases = [
            (0.0, "0"),
            (1.0, "1.00"),
            (-12.345, "-12.3"),
            (0.012_34, "0.0123"),
            (123.456, "123"),
            (98_765.4, "98765"),
            (3e-17, "3.0e-17"),
            (2.5e9, "2.5e9"),
        ];
        for (x, text) in cases {
            assert_eq!(number(x), text);
        }
        assert_eq!([0.3, 0.015, 0.0, 8e-9].map(round_percent), ["30 %", "1.5 %", "0 %", "8.0e-7 %"]);
        assert_eq!((or_dash(Some(5.0)), or_dash(None)), ("5.00".to_owned(), NONE.to_owned()));
    }
}
