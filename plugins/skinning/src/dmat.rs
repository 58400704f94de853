//! Matrices in files as libigl writes them (`.dmat`): a line with the numbers of columns and rows, and then
//! all numbers, one column after the other. Binary ones begin with a line `0 0`, and have numbers of double
//! precision, the least byte first, behind the line of their size.

use std::path::Path;

/// The number of entries, at most.
const MOST: usize = 1 << 26;
/// Largest number of bytes of a file: 32 for each number, as text.
const MOST_BYTES: u64 = 32 * MOST as u64;

/// Defect of a file, and the line that it is in, if it is in one.
pub type Wrong = (Option<usize>, String);

/// A matrix of finite numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Matrix {
    pub rows: usize,
    pub columns: usize,
    /// Column after column.
    numbers: Vec<f64>,
}

impl Matrix {
    /// Number at a row and a column.
    pub fn number(&self, row: usize, column: usize) -> f64 {
        self.numbers[column * self.rows + row]
    }

    /// The matrix in a file.
    ///
    /// # Errors
    /// The file cannot be read, or is no matrix: the error says what is wrong.
    pub fn read(path: &Path) -> Result<Self, Wrong> {
        let unreadable = |e: std::io::Error| (None, format!("cannot be read: {e}"));
        if std::fs::metadata(path).map_err(unreadable)?.len() > MOST_BYTES {
            return Err((None, "is too large".to_owned()));
        }
        Self::parse(&std::fs::read(path).map_err(unreadable)?)
    }

    /// Line of the file in which a number stands, if the file is text; the file is read again for it.
    pub fn line(&self, path: &Path, row: usize, column: usize) -> Option<usize> {
        let text = std::fs::read_to_string(path).ok()?;
        let (_, rest) = text.split_once('\n')?;
        // The first bytes of a binary file may be text as well.
        let is_text = rest.split_whitespace().count() == self.rows * self.columns;
        is_text.then(|| line_of(rest, column * self.rows + row)).flatten()
    }

    fn parse(bytes: &[u8]) -> Result<Self, Wrong> {
        let begun = |what: String| (Some(1), what);
        let (columns, rows, rest) = size(bytes).map_err(begun)?;
        let is_binary = columns == 0 && rows == 0 && !rest.is_empty();
        let (columns, rows, rest) =
            if is_binary { size(rest).map_err(|what| (Some(2), what))? } else { (columns, rows, rest) };
        let count = columns.checked_mul(rows).filter(|n| *n <= MOST);
        let count = count.ok_or_else(|| begun(format!("has {rows} rows of {columns}, which is too many")))?;
        let wrong = |there: usize| Err((None, format!("has {there} numbers instead of {count}")));
        let (mut text, mut numbers) = (None, Vec::new());
        if is_binary {
            let (there, left) = rest.as_chunks::<8>();
            if there.len() != count || !left.is_empty() {
                return wrong(there.len() + usize::from(!left.is_empty()));
            }
            numbers.extend(there.iter().map(|b| f64::from_le_bytes(*b)));
        } else {
            let words = std::str::from_utf8(rest).map_err(|_| (None, "is no text".to_owned()))?;
            text = Some(words);
            for (i, word) in words.split_whitespace().take(count).enumerate() {
                let no_number = |_| (line_of(words, i), format!("has `{}`, which is no number", short(word)));
                numbers.push(word.parse::<f64>().map_err(no_number)?);
            }
            match words.split_whitespace().count() {
                there if there != count => return wrong(there),
                _ => {}
            }
        }
        match numbers.iter().position(|x| !x.is_finite()) {
            Some(i) => {
                let (row, column) = (i % rows + 1, i / rows + 1);
                let what = format!(
                    "has `{}` in row {row}, column {column}, and that is no finite number",
                    numbers[i]
                );
                Err((text.and_then(|text| line_of(text, i)), what))
            }
            None => Ok(Self { rows, columns, numbers }),
        }
    }
}

/// The line of the word of a number, from 0 on, behind a first line.
fn line_of(text: &str, word: usize) -> Option<usize> {
    let mut before = 0;
    let has_it = |(_, line): &(usize, &str)| {
        before += line.split_whitespace().count();
        before > word
    };
    (2..).zip(text.lines()).find(has_it).map(|(line, _)| line)
}

/// Columns and rows in a first line, and the bytes behind it.
fn size(bytes: &[u8]) -> Result<(usize, usize, &[u8]), String> {
    let wrong = || "does not begin with its numbers of columns and rows".to_owned();
    let end = bytes.iter().take(256).position(|b| *b == b'\n').ok_or_else(wrong)?;
    let line = std::str::from_utf8(&bytes[..end]).map_err(|_| wrong())?;
    let numbers: Option<Vec<usize>> = line.split_whitespace().map(|word| word.parse().ok()).collect();
    match numbers.as_deref() {
        Some([columns, rows]) => Ok((*columns, *rows, &bytes[end + 1..])),
        _ => Err(wrong()),
    }
}

fn short(word: &str) -> String {
    word.chars().take(20).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn text_and_binary_are_the_same() {
        let text = Matrix::parse(b"2 3\n1\n2\n3\n-4e-1 5 6\n").unwrap();
        assert_eq!((text.rows, text.columns, text.number(2, 0), text.number(0, 1)), (3, 2, 3.0, -0.4));
        let mut binary = b"0 0\n2 3\n".to_vec();
        [1.0, 2.0, 3.0, -0.4, 5.0, 6.0_f64].iter().for_each(|x| binary.extend(x.to_le_bytes()));
        assert_eq!(Matrix::parse(&binary).unwrap(), text);
    }

    #[test]
    fn what_is_no_matrix_is_refused() {
        let told = |bytes: &[u8], line: Option<usize>, what: &str| {
            let (at, error) = Matrix::parse(bytes).unwrap_err();
            assert!(at == line && error.contains(what), "{at:?}: {error}");
        };
        told(b"", Some(1), "columns and rows");
        told(b"2 3 4\n", Some(1), "columns and rows");
        told(b"2 2\n1 2 3\n", None, "3 numbers instead of 4");
        told(b"1 2\n1 x\n", Some(2), "`x`");
        told(b"1 3\n1\n\n2\nx\n", Some(5), "`x`");
        told(b"1 2\n1 nan\n", Some(2), "row 2, column 1");
        told(b"2 2\n1\n2\n3\ninf\n", Some(5), "row 2, column 2");
        told(b"2 2\n1 2 3 4 5\n", None, "5 numbers instead of 4");
        told(b"0 0\n2 2\n12345678", None, "1 numbers instead of 4");
        told(b"0 0\n1 1\n1234567812345678", None, "2 numbers instead of 1");
        told(b"0 0\n1 1\n123456781", None, "2 numbers instead of 1");
        told(b"0 0\nx\n123456781", Some(2), "columns and rows");
        told(b"4000000000 4000000000\n", Some(1), "too many");
    }

    proptest! {
        #[test]
        fn nothing_makes_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = Matrix::parse(&bytes);
            let _ = Matrix::parse(&[b"0 0\n1 3\n", &bytes[..]].concat());
            let _ = Matrix::parse(&[b"2 3\n", &bytes[..]].concat());
        }
    }
}
