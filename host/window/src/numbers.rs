//! Numbers, sizes and times, as all of the window writes them.

use std::time::SystemTime;

/// Age of a moment, as people say it: "3 hours ago".
pub fn ago(time: SystemTime) -> String {
    let seconds = time.elapsed().unwrap_or_default().as_secs();
    let some = |count: u64, unit: &str| {
        let ending = if count == 1 { "" } else { "s" };
        format!("{count} {unit}{ending} ago")
    };
    match seconds {
        0..60 => "just now".to_owned(),
        60..3600 => some(seconds / 60, "minute"),
        3600..86_400 => some(seconds / 3600, "hour"),
        _ => some(seconds / 86_400, "day"),
    }
}

/// Duration in the words of people, from seconds.
pub fn duration(seconds: f64) -> String {
    match seconds.max(0.0).round() as u64 {
        s @ 0..60 => format!("{s} s"),
        s @ 60..3600 => format!("{} min {} s", s / 60, s % 60),
        s => format!("{} h {} min", s / 3600, s / 60 % 60),
    }
}

/// A number with three digits that matter, as all numbers are written here: thin spaces between thousands,
/// and powers of ten as the command line has them where it is very large or small.
pub fn number(x: f64) -> String {
    let minus = if x < 0.0 { "\u{2212}" } else { "" };
    match x.abs() {
        0.0 => "0".to_owned(),
        a if !a.is_finite() => format!("{x}"),
        a if !(1e-3..1e6).contains(&a) => format!("{minus}{a:.2e}"),
        a if a >= 999.5 => format!("{minus}{}", count(a.round() as u64)),
        a => {
            let decimals = (2.0 - a.log10().floor()).clamp(0.0, 5.0) as usize;
            format!("{minus}{a:.decimals$}")
        }
    }
}

/// A count with thin spaces between thousands.
pub fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push('\u{2009}');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_easily() {
        assert_eq!(count(1234567), "1\u{2009}234\u{2009}567");
        assert_eq!(count(12), "12");
        let all = [0.0f64, 1.234, 0.01234, 1234.5, 1.2e-6, -3.456e9, 999.7].map(number);
        let expected = ["0", "1.23", "0.0123", "1\u{2009}235", "1.20e-6", "\u{2212}3.46e9", "1\u{2009}000"];
        assert_eq!(all, expected);
        assert_eq!(
            (duration(0.4), duration(59.7), duration(3725.0)),
            ("0 s".into(), "1 min 0 s".into(), "1 h 2 min".into())
        );
        let before = |seconds: u64| ago(SystemTime::now() - std::time::Duration::from_secs(seconds));
        assert_eq!(
            [before(3), before(61), before(7300), before(90_000)],
            ["just now", "1 minute ago", "2 hours ago", "1 day ago"]
        );
    }
}
