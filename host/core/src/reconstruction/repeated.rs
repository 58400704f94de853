//! Vertices at the places of others: corners of a soup, as STL has them, are six times at each place in the
//! mean. The deformed position of a vertex depends on its place alone, so it is found once.

use glam::DVec3;

/// Number of vertices that are looked at to tell whether places are repeated.
const LOOKED_AT: usize = 192;

/// No place so far.
const NONE: u32 = u32::MAX;

/// The different places of vertices.
///
/// Memory: at most 28 bytes for each vertex while they are found, and 12 after that.
pub struct Repeated {
    /// The first vertex at each place.
    pub first: Vec<u32>,
    /// Number of vertices at each place.
    pub count: Vec<u32>,
    /// The place of each vertex.
    place: Vec<u32>,
}

impl Repeated {
    /// The places of vertices (fewer than 2³¹) of which most are at those of others; `None` where they are
    /// not, as the first ones tell.
    pub fn find(positions: &[DVec3]) -> Option<Self> {
        let some = Self::of_all(positions.get(..LOOKED_AT)?);
        (2 * some.first.len() < LOOKED_AT).then(|| Self::of_all(positions))
    }

    fn of_all(positions: &[DVec3]) -> Self {
        let bits = (2 * positions.len()).next_power_of_two().trailing_zeros().max(1);
        let mut table = vec![NONE; 1 << bits];
        let (mut first, mut count) = (Vec::<u32>::new(), Vec::new());
        let place = |(vertex, p): (usize, &DVec3)| {
            let key = p.to_array().map(f64::to_bits);
            let mut at = hash(key) >> (u64::BITS - bits);
            // There are twice as many slots as vertices.
            loop {
                let slot = &mut table[at as usize];
                if *slot == NONE {
                    *slot = first.len() as u32;
                    first.push(vertex as u32);
                    count.push(1);
                    return *slot;
                }
                let known = positions[first[*slot as usize] as usize];
                if known.to_array().map(f64::to_bits) == key {
                    count[*slot as usize] += 1;
                    return *slot;
                }
                at = (at + 1) & ((1 << bits) - 1);
            }
        };
        let place = positions.iter().enumerate().map(place).collect();
        Self { first, count, place }
    }

    /// Values of the first vertex at each place, from those of all vertices.
    pub fn gather<T: Copy>(&self, of_vertices: &[T]) -> Vec<T> {
        self.first.iter().map(|vertex| of_vertices[*vertex as usize]).collect()
    }

    /// Gives each vertex the value of its place.
    pub fn scatter<T: Copy>(&self, of_places: &[T], to: &mut [T]) {
        to.iter_mut().zip(&self.place).for_each(|(to, place)| *to = of_places[*place as usize]);
    }
}

/// Hash of a place, whose upper bits differ from place to place.
fn hash([x, y, z]: [u64; 3]) -> u64 {
    // Odd numbers without a pattern: digits of the golden ratio, and two others.
    const BY: [u64; 3] = [0x9e37_79b9_7f4a_7c15, 0xc2b2_ae3d_27d4_eb4f, 0x1656_67b1_9e37_79f9];
    let mixed =
        x.wrapping_mul(BY[0]) ^ y.wrapping_mul(BY[1]).rotate_left(21) ^ z.wrapping_mul(BY[2]).rotate_left(42);
    (mixed ^ mixed >> 29).wrapping_mul(BY[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn each_vertex_has_what_its_place_has(
            numbers in prop::collection::vec((0..40u32, prop_oneof![Just(0.0), Just(-0.0), Just(f64::NAN), -1.0..1.0f64]), 0..900),
        ) {
            let positions: Vec<DVec3> = numbers.iter().map(|(i, x)| DVec3::new(f64::from(*i), *x, 1e7)).collect();
            let places = Repeated::of_all(&positions);
            prop_assert_eq!(places.count.iter().sum::<u32>() as usize, positions.len());
            let gathered = places.gather(&positions);
            let bits = |p: &DVec3| p.to_array().map(f64::to_bits);
            let different: std::collections::BTreeSet<_> = gathered.iter().map(bits).collect();
            prop_assert_eq!(different.len(), gathered.len());
            let mut back = vec![DVec3::ZERO; positions.len()];
            places.scatter(&gathered, &mut back);
            prop_assert!(back.iter().map(bits).eq(positions.iter().map(bits)));
        }
    }

    #[test]
    fn only_what_repeats_is_gathered() {
        let apart: Vec<DVec3> = (0..1000).map(|i| DVec3::splat(f64::from(i))).collect();
        assert!(Repeated::find(&apart).is_none());
        let corners: Vec<DVec3> = (0..1000).map(|i| DVec3::splat(f64::from(i / 3))).collect();
        assert_eq!(Repeated::find(&corners).map(|places| places.first.len()), Some(334));
        assert!(Repeated::find(&corners[..100]).is_none());
    }
}
