//! Numbers of as few bytes as they need: seven bits in each byte, the lowest first; the highest bit says that
//! there are more.

/// Appends a number.
pub(crate) fn push(mut x: u64, to: &mut Vec<u8>) {
    while x >= 0x80 {
        to.push(x as u8 | 0x80);
        x >>= 7;
    }
    to.push(x as u8);
}

/// The numbers of these bytes, up to the first that is none.
pub(crate) struct VarintNumbers<'a>(pub &'a [u8]);

impl Iterator for VarintNumbers<'_> {
    type Item = u64;

    fn next(&mut self) -> Option<u64> {
        let mut x = 0;
        for shift in (0..63).step_by(7) {
            let (byte, rest) = self.0.split_first()?;
            self.0 = rest;
            x |= u64::from(byte & 0x7f) << shift;
            if *byte < 0x80 {
                return Some(x);
            }
        }
        None
    }
}
