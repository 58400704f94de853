//! Limits of a plugin's description of itself: the same for all, whatever they are written in.

use simod_plugin_api::{Descriptor, ParamDesc};

/// Longest text, in bytes: a longer one is taken for one without an end.
pub(crate) const LONGEST_TEXT: usize = 1 << 16;

/// Longest list: a greater length is taken for no count.
pub(crate) const LONGEST_LIST: usize = 10_000;

/// The most that all texts take together, in bytes.
const LONGEST_TEXTS: usize = 16 << 20;

/// Texts of a description, each with its name for messages.
pub fn texts(d: &Descriptor) -> Vec<(&str, String)> {
    let of_plugin = [
        (&d.id, "id"),
        (&d.name, "name"),
        (&d.version, "version"),
        (&d.summary, "summary"),
        (&d.citation, "citation"),
        (&d.author, "author"),
        (&d.url, "address"),
    ];
    let mut texts: Vec<(&str, String)> =
        of_plugin.into_iter().map(|(text, what)| (text.as_str(), format!("the plugin's {what}"))).collect();
    texts.extend(d.inputs.iter().map(|input| (input.id.as_str(), "the id of an input".to_owned())));
    for p in &d.params {
        let of = |what: &str| format!("the {what} of parameter `{}`", called(p));
        texts.extend([
            (p.id.as_str(), of("id")),
            (p.name.as_str(), of("name")),
            (p.hint.as_str(), of("hint")),
            (p.group.as_str(), of("group")),
            (p.default_text.as_str(), of("default")),
        ]);
        for choice in &p.choices {
            texts.extend([
                (choice.id.as_str(), of("id of a choice")),
                (choice.label.as_str(), of("label of a choice")),
            ]);
        }
    }
    texts
}

/// Id of a parameter in messages, as far as it can be read.
fn called(p: &ParamDesc) -> String {
    p.id.chars().take(40).collect()
}

/// Checks that a description keeps within the limits; the error names the part that is too long.
pub fn check(d: &Descriptor) -> Result<(), String> {
    let list = |length: usize, what: &dyn Fn() -> String| {
        if length <= LONGEST_LIST {
            return Ok(());
        }
        Err(format!("{} are {length}, more than {LONGEST_LIST}", what()))
    };
    list(d.params.len(), &|| "the parameters".to_owned())?;
    list(d.inputs.len(), &|| "the inputs".to_owned())?;
    for p in &d.params {
        list(p.choices.len(), &|| format!("the choices of parameter `{}`", called(p)))?;
        list(p.default_numbers.len(), &|| format!("the default numbers of parameter `{}`", called(p)))?;
    }
    let texts = texts(d);
    if let Some((text, what)) = texts.iter().find(|(text, _)| text.len() >= LONGEST_TEXT) {
        return Err(format!("{what} is {} bytes long, more than {}", text.len(), LONGEST_TEXT - 1));
    }
    let all: usize = texts.iter().map(|(text, _)| text.len()).sum();
    if all > LONGEST_TEXTS {
        return Err(format!("its texts are {all} bytes together, more than {LONGEST_TEXTS}"));
    }
    Ok(())
}

/// Whether a character does something to a terminal, or to the order of the text that is read, instead of
/// being shown.
pub fn is_raw(c: char) -> bool {
    c.is_control() || matches!(c, '\u{2028}' | '\u{2029}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_too_much_is_named() {
        let told = |d: &Descriptor, what: &str| {
            let error = check(d).unwrap_err();
            assert!(error.contains(what) && error.len() < 200, "{error}");
        };
        let x = || Descriptor::new("x", "X", "1.0.0");
        let by = |i: usize| ParamDesc::float(&format!("p{i}"), "P", 0.0);
        let many = |n| (0..n).map(by).fold(x(), Descriptor::param);
        assert_eq!(check(&many(LONGEST_LIST)), Ok(()));
        told(&many(LONGEST_LIST + 1), "the parameters are 10001");
        let long = "x".repeat(LONGEST_TEXT);
        told(&x().summary(&long), "the plugin's summary is 65536 bytes");
        told(&x().param(by(0).hint(&long)), "the hint of parameter `p0`");
        assert_eq!(check(&x().param(by(0).hint(&long[1..]))), Ok(()));
        let ids: Vec<String> = (0..=LONGEST_LIST).map(|i| format!("c{i}")).collect();
        let choices: Vec<_> = ids.iter().map(|id| (id.as_str(), "C")).collect();
        told(&x().param(ParamDesc::choice("c", "C", "c0", &choices)), "the choices of parameter `c`");
        let wordy = (0..300).map(|i| by(i).hint(&long[1..])).fold(x(), Descriptor::param);
        told(&wordy, "its texts are");
    }

    #[test]
    fn raw_characters_are_those_that_are_not_shown() {
        assert!(['\u{1b}', '\n', '\r', '\u{9b}', '\u{7f}', '\u{202e}', '\t'].into_iter().all(is_raw));
        assert!(!"Größe – 大きさ".chars().any(is_raw));
    }
}
