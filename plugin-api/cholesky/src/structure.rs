//! Structure of a factorisation, found before there is any number: the unknowns of each front, and the memory
//! that it takes.
//!
//! J. Liu, *The Multifrontal Method for Sparse Matrix Solution*, SIAM Review 1992. A surface's fronts are
//! small. Where samples in one place are joined without any order, they are not, and what cannot be held is
//! refused here.

use crate::dissection::{EliminationTree, Supernode};
use crate::refusal::Refusal;
use simod_plugin_api::Host;
use std::ops::Range;

/// Bytes of a factorisation, at most: several times what a million samples of a surface take.
const MOST: u64 = 4 << 30;

/// The unknowns after each part that have to do with it, ascending.
#[derive(Debug, Default)]
pub struct Structure {
    /// The rows of each part.
    pub rows: Vec<Vec<u32>>,
}

/// The memory that some parts take.
#[derive(Debug, Default)]
struct Taken {
    /// Bytes that are kept.
    kept: u64,
    /// And those of updates that wait for their parents.
    waiting: u64,
}

impl Structure {
    /// Of a tree, and the columns from the diagonal on that each row of the matrix in its order has. `size`
    /// is that of an entry that is kept, in bytes.
    pub fn new<'a>(
        tree: &EliminationTree,
        columns: impl Fn(usize) -> &'a [u32] + Sync,
        size: usize,
        host: &Host<'_>,
    ) -> Result<Self, Refusal> {
        let size = size as u64;
        let mut tasks: Vec<_> =
            tree.subtrees.iter().map(|parts| (parts.clone(), Vec::new(), Ok(Taken::default()))).collect();
        host.parallel_blocks(&mut tasks, 1, |_, tasks| {
            for (parts, rows, taken) in tasks {
                let mut sum = Taken::default();
                *taken = add(&tree.parts, parts.clone(), parts.start, rows, &mut sum, (&columns, size), host)
                    .map(|()| sum);
            }
        })?;
        let mut this = Self::default();
        let mut taken = Taken::default();
        for (_, rows, of_one) in tasks {
            let of_one = of_one?;
            taken.kept += of_one.kept;
            taken.waiting += of_one.waiting;
            this.rows.extend(rows);
        }
        let top = this.rows.len()..tree.parts.len();
        add(&tree.parts, top, 0, &mut this.rows, &mut taken, (&columns, size), host)?;
        Ok(this)
    }
}

/// Finds the rows of a range of parts. `rows` are those of the parts from `first` on.
fn add<'a>(
    parts: &[Supernode],
    range: Range<usize>,
    first: usize,
    rows: &mut Vec<Vec<u32>>,
    taken: &mut Taken,
    (columns, size): (&impl Fn(usize) -> &'a [u32], u64),
    host: &Host<'_>,
) -> Result<(), Refusal> {
    let square = |count: usize| 8 * (count as u64).pow(2);
    for part in &parts[range] {
        let mut own: Vec<u32> = part.children.iter().flat_map(|c| &rows[*c - first]).copied().collect();
        own.extend(part.columns.clone().flat_map(columns));
        own.retain(|r| *r as usize >= part.columns.end);
        own.sort_unstable();
        own.dedup();
        let (width, height) = (part.columns.len() as u64, own.len() as u64);
        taken.kept += size * width * (height + width.div_ceil(2));
        taken.waiting += square(own.len());
        if taken.kept + taken.waiting + 8 * width * (width + height) > MOST {
            return Err(Refusal::TooLarge);
        }
        taken.waiting -= part.children.iter().map(|c| square(rows[*c - first].len())).sum::<u64>();
        rows.push(own);
        if rows.len().is_multiple_of(256) {
            host.progress(0.0)?;
        }
    }
    Ok(())
}
