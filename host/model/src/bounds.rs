//! Bounding boxes.

use glam::DVec3;

/// An axis-aligned box in the model's coordinates, empty at first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Corner of least coordinates; +∞ while empty.
    pub min: DVec3,
    /// Corner of greatest coordinates; −∞ while empty.
    pub max: DVec3,
}

impl Default for Bounds {
    fn default() -> Self {
        Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY }
    }
}

impl Bounds {
    /// The smallest box that holds the points.
    pub fn from_points(points: impl IntoIterator<Item = DVec3>) -> Self {
        let mut bounds = Self::default();
        points.into_iter().for_each(|p| bounds.include(p));
        bounds
    }

    /// Grows the box to hold `p`.
    #[inline]
    pub fn include(&mut self, p: DVec3) {
        self.min = self.min.min(p);
        self.max = self.max.max(p);
    }

    /// Grows the box to hold another one.
    #[inline]
    pub fn absorb(&mut self, other: &Self) {
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
    }

    /// Whether the point lies in the box or on its faces; no point with a NaN does.
    #[inline]
    pub fn contains(&self, p: DVec3) -> bool {
        p.cmpge(self.min).all() && p.cmple(self.max).all()
    }

    /// Whether no point was included yet.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.min.x > self.max.x
    }

    /// The middle of the box.
    #[inline]
    pub fn center(&self) -> DVec3 {
        // Halved before they are added: the sum of two corners near the largest double overflows.
        self.min * 0.5 + self.max * 0.5
    }

    /// Length of the diagonal, the unit of every error bound; 0 for a single point.
    pub fn diagonal(&self) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        let extent = self.max - self.min;
        // Scaled, so that squares neither overflow nor vanish.
        let largest = extent.max_element();
        if largest > 0.0 { largest * (extent / largest).length() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn diagonal_holds_at_extreme_scales() {
        for scale in [1e-300, 1e-30, 1.0, 1e30, 1e300] {
            let b = Bounds::from_points([DVec3::ZERO, DVec3::new(2.0, 3.0, 6.0) * scale]);
            assert!((b.diagonal() / scale - 7.0).abs() < 1e-12);
        }
        assert_eq!(Bounds::from_points([DVec3::ONE]).diagonal(), 0.0);
        assert_eq!(Bounds::default().diagonal(), 0.0);
    }
}
