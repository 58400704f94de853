//! Polygons and strips as triangles, corner by corner: neither is ever held.

/// The corners so far of a polygon or of a strip.
#[derive(Debug, Default)]
pub(crate) struct Fan {
    /// Number of corners, up to three.
    corners: u8,
    /// The two corners that the next one makes a triangle with, in this order.
    pair: [u32; 2],
    /// Whether the next triangle of a strip has the other orientation.
    turned: bool,
}

impl Fan {
    /// Adds the next corner of a polygon, and returns the triangle that this corner completes.
    #[inline]
    pub(crate) fn polygon(&mut self, index: i64) -> Option<[u32; 3]> {
        let [first, last] = self.pair;
        let corner = self.add(index)?;
        self.pair = [first, corner];
        self.corners = 3;
        Some([first, last, corner])
    }

    /// Whether the next triangle of a polygon is not the first one.
    #[inline]
    pub(crate) fn has_triangle(&self) -> bool {
        self.corners == 3
    }

    /// The next corner of a strip, or -1 to begin a new one; and the triangle that it ends.
    pub(crate) fn strip(&mut self, index: i64) -> Option<[u32; 3]> {
        // In a list of type uint, -1 looks so.
        if index == -1 || index == i64::from(u32::MAX) {
            *self = Self::default();
            return None;
        }
        let [a, b] = self.pair;
        let corner = self.add(index)?;
        self.pair = [b, corner];
        self.turned = !self.turned;
        Some(if self.turned { [a, b, corner] } else { [b, a, corner] })
    }

    /// Adds a corner, and returns it if two came before it.
    #[inline]
    fn add(&mut self, index: i64) -> Option<u32> {
        let corner = u32::try_from(index).unwrap_or(u32::MAX);
        if self.corners >= 2 {
            return Some(corner);
        }
        self.pair[usize::from(self.corners)] = corner;
        self.corners += 1;
        None
    }
}
