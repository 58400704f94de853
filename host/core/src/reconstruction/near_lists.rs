//! Short lists of samples in few bytes. Samples near each other mostly have numbers near each other, so each
//! is written as the difference to the one that the list is of: in one byte, or two, or six where it is far
//! off.

/// Longest list.
pub const LONGEST: usize = 32;

/// Code in place of a difference of two bytes that says that four more bytes have the difference.
const FAR: u32 = 0xffff;

/// Bytes that have to follow the last list, as two are read where one may be all.
pub const BEHIND: [u8; 1] = [0];

/// Appends a list of at most [`LONGEST`] samples: a bit for each that says whether it takes two bytes, and
/// the bytes.
pub fn push(of: u32, list: &[u32], to: &mut Vec<u8>) {
    let mut bytes = [0; LONGEST / 8 + 6 * LONGEST];
    let (mut long, mut end) = (0u32, LONGEST / 8);
    for (bit, sample) in list.iter().enumerate() {
        let way = sample.wrapping_sub(of).cast_signed();
        let difference = ((way << 1) ^ (way >> 31)).cast_unsigned();
        // Without a branch, as which ones are long cannot be foretold.
        let is_long = difference >= 1 << 8;
        bytes[end..end + 2].copy_from_slice(&(difference.min(FAR) as u16).to_le_bytes());
        long |= u32::from(is_long) << bit;
        end += 1 + usize::from(is_long);
        if difference >= FAR {
            bytes[end..end + 4].copy_from_slice(&difference.to_le_bytes());
            end += 4;
        }
    }
    bytes[..LONGEST / 8].copy_from_slice(&long.to_le_bytes());
    to.extend_from_slice(&bytes[..end]);
}

/// Takes a list of as many samples as `list` has off the beginning of `bytes`, [behind](BEHIND) which there
/// is something; `None` if it is cut off. The samples may be anything.
pub fn take(of: u32, list: &mut [u32], bytes: &mut &[u8]) -> Option<()> {
    let (long, rest) = bytes.split_first_chunk()?;
    let long = u32::from_le_bytes(*long);
    let mut at = 0;
    for (bit, sample) in list.iter_mut().enumerate() {
        let two = rest.get(at..at + 2)?;
        // Without a branch, as which ones are long cannot be foretold.
        let is_long = long >> bit & 1;
        let mut difference = u32::from(two[0]) | ((u32::from(two[1]) * is_long) << 8);
        at += 1 + is_long as usize;
        if difference == FAR {
            difference = u32::from_le_bytes(*rest.get(at..)?.first_chunk()?);
            at += 4;
        }
        *sample = of.wrapping_add((difference >> 1) ^ (difference & 1).wrapping_neg());
    }
    *bytes = rest.get(at..)?;
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn lists_come_back(
            of in 0..1u32 << 29,
            lists in prop::collection::vec(prop::collection::vec(
                prop_oneof![-200..200i64, -40_000..40_000i64, -(1i64 << 29)..1i64 << 29], 0..=LONGEST), 0..5),
        ) {
            let sample = |way: &i64| (i64::from(of) + way).clamp(0, (1 << 29) - 1) as u32;
            let lists: Vec<Vec<u32>> = lists.iter().map(|list| list.iter().map(sample).collect()).collect();
            let mut bytes = Vec::new();
            lists.iter().for_each(|list| push(of, list, &mut bytes));
            bytes.extend(BEHIND);
            let mut rest = &bytes[..];
            for list in &lists {
                let mut back = vec![0; list.len()];
                prop_assert!(take(of, &mut back, &mut rest).is_some());
                prop_assert_eq!(&back, list);
            }
            prop_assert_eq!(rest, BEHIND);
            // Bytes that are cut off give no list.
            let mut rest = &bytes[..bytes.len() / 2];
            let taken = lists.iter().try_for_each(|list| take(of, &mut vec![0; list.len()], &mut rest));
            prop_assert!(lists.is_empty() || taken.is_none() || lists.iter().all(Vec::is_empty));
        }
    }
}
