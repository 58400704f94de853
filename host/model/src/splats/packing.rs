//! Numbers of splats in few bits, and back.

/// The first function of the harmonics, by which colours are.
const FIRST: f64 = 0.282_094_791_773_878_14;

/// A colour from 0 to 1, as the first coefficient of the harmonics.
pub(super) fn coefficient(colour: f64) -> f64 {
    (colour - 0.5) / FIRST
}

/// Opacity before the sigmoid. That of 0 and of 255 would not be finite: a quarter of a step is kept from
/// either.
pub(super) fn opacity(byte: u8) -> f64 {
    let opacity = f64::from(byte).clamp(0.25, 254.75) / 255.0;
    (opacity / (1.0 - opacity)).ln()
}

/// The byte of an opacity before the sigmoid.
pub(super) fn opacity_byte(opacity: f64) -> u8 {
    (255.0 / (1.0 + (-opacity).exp())).round() as u8
}

/// The part of the whole that a number of so many bits stands for.
pub(super) fn part(bits: u32, of: u32) -> f64 {
    let most = (1u32 << of) - 1;
    f64::from(bits & most) / f64::from(most)
}

/// The number of so many bits that is nearest to a part of the whole.
pub(super) fn bits(part: f64, of: u32) -> u32 {
    // A conversion saturates, and gives 0 for NaN.
    let most = (1u32 << of) - 1;
    ((part * f64::from(most) + 0.5).floor() as u32).min(most)
}

/// Number of bits of each of the three numbers of a position or of scales, and their shift to the left.
const THREE: [[u32; 2]; 3] = [[11, 21], [10, 11], [11, 0]];

/// Three parts of the whole.
pub(super) fn three(packed: u32) -> [f64; 3] {
    THREE.map(|[of, shift]| part(packed >> shift, of))
}

pub(super) fn pack_three(parts: [f64; 3]) -> u32 {
    THREE.iter().zip(parts).map(|([of, shift], p)| bits(p, *of) << shift).sum()
}

/// A quaternion: which of its numbers is the largest, and the others in order, between −√½ and √½.
pub(super) fn quaternion(packed: u32) -> [f64; 4] {
    let others = [20, 10, 0].map(|shift| (part(packed >> shift, 10) - 0.5) * std::f64::consts::SQRT_2);
    let largest = (1.0 - others.iter().map(|x| x * x).sum::<f64>()).max(0.0).sqrt();
    let (mut q, mut next) = ([largest; 4], others.into_iter());
    for (_, to) in q.iter_mut().enumerate().filter(|(i, _)| *i != (packed >> 30) as usize) {
        *to = next.next().unwrap_or_default();
    }
    q
}

/// Packs a quaternion of any length and sign.
pub(super) fn pack_quaternion(q: [f64; 4]) -> u32 {
    let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    let largest = (1..4).fold(0, |best: usize, i| if q[i].abs() > q[best].abs() { i } else { best });
    let unit = length.copysign(q[largest]);
    let others = q.iter().enumerate().filter(|(i, _)| *i != largest);
    others.fold(largest as u32, |packed, (_, x)| packed << 10 | bits(x / unit * 0.5f64.sqrt() + 0.5, 10))
}

/// A coefficient of the harmonics, from −4 to 4.
pub(super) fn harmonic(byte: u8) -> f64 {
    let part = match byte {
        0 => 0.0,
        255 => 1.0,
        byte => (f64::from(byte) + 0.5) / 256.0,
    };
    (part - 0.5) * 8.0
}

pub(super) fn harmonic_byte(coefficient: f64) -> u8 {
    ((coefficient / 8.0 + 0.5) * 256.0).floor() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_was_packed_packs_the_same(packed: u32, byte: u8) {
            prop_assert_eq!(pack_three(three(packed)), packed);
            prop_assert_eq!(opacity_byte(opacity(byte)), byte);
            prop_assert_eq!(harmonic_byte(harmonic(byte)), byte);
        }

        #[test]
        fn quaternions_are_as_near_as_their_bits(q in prop::array::uniform4(-1.0f64..1.0)) {
            let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
            prop_assume!(length > 1e-3);
            let found = quaternion(pack_quaternion(q));
            let dot: f64 = found.iter().zip(q).map(|(a, b)| a * b / length).sum();
            for (a, b) in found.iter().zip(q) {
                // Half a step of the others, and what they make of the largest.
                prop_assert!((a - b / length * dot.signum()).abs() < 3e-3, "{found:?} of {q:?}");
            }
        }

        #[test]
        fn nothing_panics(q in prop::array::uniform4(prop::num::f64::ANY), x in prop::num::f64::ANY) {
            pack_quaternion(q);
            pack_three([x, q[0], q[1]]);
            prop_assert!(harmonic_byte(x) == 0 || x > -4.0);
            prop_assert!(opacity_byte(x) < 128 || x > -1e-2);
            prop_assert_eq!(coefficient(x).is_nan(), x.is_nan());
        }
    }
}
