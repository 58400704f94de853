//! Matrices in files as libigl writes them (`.dmat`): a line with the numbers of columns and rows, and then
//! all numbers, one column after the other. Binary ones begin with a line `0 0`, and have numbers of double
//! precision, the least byte first, behind the line of their size.

use std::path::Path;

/// Most numbers.
const MOST: usize = 1 << 26;
/// Most bytes of a file: 32 for each number, as text.
const MOST_BYTES: u64 = 32 * MOST as u64;

/// A matrix of finite numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Matrix {
    pub rows: usize,
    pub columns: usize,
    /// Column after column.
    numbers: Vec<f64>,
}

impl Matrix {
    /// A number of it.
    pub fn at(&self, row: usize, column: usize) -> f64 {
        self.numbers[column * self.rows + row]
    }

    /// The matrix in a file.
    ///
    /// # Errors
    /// They say what is wrong.
    pub fn read(path: &Path) -> Result<Self, String> {
        let unreadable = |e: std::io::Error| format!("cannot be read: {e}");
        if std::fs::metadata(path).map_err(unreadable)?.len() > MOST_BYTES {
            return Err("is too large".to_owned());
        }
        Self::parse(&std::fs::read(path).map_err(unreadable)?)
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let (columns, rows, rest) = size(bytes)?;
        let is_binary = columns == 0 && rows == 0 && !rest.is_empty();
        let (columns, rows, rest) = if is_binary { size(rest)? } else { (columns, rows, rest) };
        let count = columns.checked_mul(rows).filter(|n| *n <= MOST);
        let count = count.ok_or_else(|| format!("has {rows} rows of {columns}, which is too many"))?;
        let wrong = |there: usize| Err(format!("has {there} numbers instead of {count}"));
        let numbers: Vec<f64> = if is_binary {
            let (numbers, left) = rest.as_chunks::<8>();
            if numbers.len() != count || !left.is_empty() {
                return wrong(numbers.len() + usize::from(!left.is_empty()));
            }
            numbers.iter().map(|b| f64::from_le_bytes(*b)).collect()
        } else {
            let text = std::str::from_utf8(rest).map_err(|_| "is no text".to_owned())?;
            let number = |word: &str| {
                word.parse::<f64>().map_err(|_| format!("has `{}`, which is no number", short(word)))
            };
            let numbers: Vec<f64> =
                text.split_whitespace().take(count).map(number).collect::<Result<_, _>>()?;
            match text.split_whitespace().count() {
                there if there != count => return wrong(there),
                _ => numbers,
            }
        };
        match numbers.iter().position(|x| !x.is_finite()) {
            Some(i) => {
                let (row, column) = (i % rows + 1, i / rows + 1);
                Err(format!(
                    "has `{}` in row {row}, column {column}, and that is no finite number",
                    numbers[i]
                ))
            }
            None => Ok(Self { rows, columns, numbers }),
        }
    }
}

/// The columns and rows in a first line, and what is behind it.
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
        assert_eq!((text.rows, text.columns, text.at(2, 0), text.at(0, 1)), (3, 2, 3.0, -0.4));
        let mut binary = b"0 0\n2 3\n".to_vec();
        [1.0, 2.0, 3.0, -0.4, 5.0, 6.0_f64].iter().for_each(|x| binary.extend(x.to_le_bytes()));
        assert_eq!(Matrix::parse(&binary).unwrap(), text);
    }

    #[test]
    fn what_is_no_matrix_is_refused() {
        let told = |bytes: &[u8], what: &str| {
            let error = Matrix::parse(bytes).unwrap_err();
            assert!(error.contains(what), "{error}");
        };
        told(b"", "columns and rows");
        told(b"2 3 4\n", "columns and rows");
        told(b"2 2\n1 2 3\n", "3 numbers instead of 4");
        told(b"1 2\n1 x\n", "`x`");
        told(b"1 2\n1 nan\n", "row 2, column 1");
        told(b"2 2\n1 2 3 4 5\n", "5 numbers instead of 4");
        told(b"0 0\n2 2\n12345678", "1 numbers instead of 4");
        told(b"0 0\n1 1\n1234567812345678", "2 numbers instead of 1");
        told(b"0 0\n1 1\n123456781", "2 numbers instead of 1");
        told(b"4000000000 4000000000\n", "too many");
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
