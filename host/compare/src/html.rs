//! Text of a page: numbers as people read them, tables.

use maud::{Markup, html};

/// Number with three significant digits.
pub(crate) fn number(x: f64) -> String {
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

/// Round share with its unit, without digits that say nothing.
pub(crate) fn round_percent(x: f64) -> String {
    let text = number(100.0 * x);
    let text = if text.contains('.') && !text.contains('e') {
        text.trim_end_matches('0').trim_end_matches('.')
    } else {
        &text
    };
    format!("{text} %")
}

/// ASCII letters and digits of a text, in lower case, with hyphens between its words.
pub(crate) fn hyphenated(text: &str) -> String {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join("-").to_ascii_lowercase()
}

/// Sign for a number that is not known, or does not make sense.
pub(crate) const NONE: &str = "–";

/// A number, or a dash.
pub(crate) fn or_dash(x: Option<f64>) -> String {
    x.map_or(NONE.to_owned(), number)
}

/// Table: first the columns of names, then those of numbers.
pub(crate) struct Table<'a> {
    caption: &'a str,
    /// Titles, with their units.
    titles: &'a [(&'a str, &'a str)],
    rows: Vec<Markup>,
}

impl<'a> Table<'a> {
    /// Table with a caption, and titles with their units below them.
    pub fn new(caption: &'a str, titles: &'a [(&'a str, &'a str)]) -> Self {
        Self { caption, titles, rows: Vec::new() }
    }

    /// Adds a row: its names, then its numbers.
    pub fn row(&mut self, names: &[&str], numbers: impl IntoIterator<Item = String>) {
        self.rows.push(html! {
            tr {
                @for name in names { th scope="row" { (name) } }
                @for number in numbers { td { (number) } }
            }
            "\n"
        });
    }

    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    pub fn finish(self) -> Markup {
        html! {
            div.wide {
                table {
                    "\n"
                    caption { (self.caption) }
                    "\n"
                    thead {
                        tr {
                            @for (title, unit) in self.titles {
                                th scope="col" {
                                    (title)
                                    @if !unit.is_empty() { br; small { (unit) } }
                                }
                            }
                        }
                    }
                    "\n"
                    tbody {
                        "\n"
                        @for row in self.rows { (row) }
                    }
                    "\n"
                }
            }
            "\n"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_stays_text() {
        let mut table = Table::new("<b>", &[("<i>", "<u>")]);
        table.row(&["<x>"], ["<y>".to_owned()]);
        let html = table.finish().into_string();
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
