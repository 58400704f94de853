//! The drawings on the tiles.

use glam::DVec2;

use super::tile::ReliefTile;
use simod_geometry::smoothstep;

/// One unit of a Greek key, between empty margins.
#[rustfmt::skip]
const MEANDER: [&[u8; 8]; 9] = [
    b"........",
    b"#######.",
    b"#.....#.",
    b"#.###.#.",
    b"#.#...#.",
    b"#.#####.",
    b"#.......",
    b"########",
    b"........",
];

/// A Greek key; its lines are as wide across as along where the unit's width is to its height as 8 to 9.
pub(super) fn meander() -> ReliefTile {
    const CELL: usize = 6;
    let (width, height) = (MEANDER[0].len(), MEANDER.len());
    ReliefTile::new(width * CELL, height * CELL, |x, y| {
        let row = height - 1 - (y * height as f64) as usize;
        f64::from(MEANDER[row][(x * width as f64) as usize] == b'#')
    })
}

/// A tongue of a gadrooned belly: a ridge with a round upper end.
pub(super) fn tongue() -> ReliefTile {
    ReliefTile::new(96, 384, |x, y| {
        let across = (2.0 * x - 1.0) / 0.94;
        let beyond = ((y - 0.86) / 0.10).max(0.0);
        (1.0 - across * across - beyond * beyond).max(0.0)
    })
}

/// Two by two strands of a basket weave.
pub(super) fn weave() -> ReliefTile {
    /// A strand along the first coordinate, over at even crossings, under at odd ones.
    fn strand(along: f64, across: f64) -> f64 {
        let over = 0.5 + 0.5 * (std::f64::consts::PI * along).cos();
        let round = 1.0 - (2.0 * across - 1.0).powi(2) / 0.85;
        if round <= 0.0 { 0.0 } else { (0.3 + 0.7 * over) * round.sqrt() }
    }
    ReliefTile::new(64, 64, |x, y| {
        let (x, y) = (2.0 * x, 2.0 * y);
        let warp = strand(y - 0.5 + x.floor(), x.fract());
        let weft = strand(x - 0.5 + y.floor() + 1.0, y.fract());
        warp.max(weft)
    })
}

/// Two rows of overlapping scales, open to below.
pub(super) fn scales() -> ReliefTile {
    // Coarse enough to give the free edges a slope that samples can follow.
    ReliefTile::new(56, 56, |x, y| {
        // Scales hang from the centres of their discs, in rows half a tile apart; upper ones lie above.
        let mut height = 0.0;
        for row in (-1..=4).rev() {
            let shift = if row % 2 == 0 { 0.0 } else { 0.5 };
            let dx = x - shift - (x - shift).round();
            let dy = y - 0.5 * f64::from(row);
            let distance = (dx * dx + dy * dy).sqrt() / 0.56;
            if dy <= 0.0 && distance < 1.0 {
                // Rising towards the free edge, with a thin rim and a midrib.
                let rim = 0.35 * step_between(0.78, 0.84, distance);
                let rib = 0.25 * (-(dx / 0.05).powi(2)).exp() * (1.0 - step_between(0.6, 0.78, distance));
                height = 0.25 + 0.4 * distance + rim + rib;
                break;
            }
        }
        height
    })
}

/// The word SIMOD and a diamond, on a tile 3.9 times as wide as it is high.
pub(super) fn lettering() -> ReliefTile {
    const ASPECT: f64 = 3.85;
    /// Letter height as a share of the tile's.
    const SIZE: f64 = 0.72;
    const HALF_STROKE: f64 = 0.075;
    const GAP: f64 = 0.21;

    let letters = word();
    let width: f64 = letters.iter().map(|letter| letter.width + GAP).sum();
    let left = 0.5 * (ASPECT / SIZE - width + GAP);
    const WIDTH: usize = 1408;
    ReliefTile::new(WIDTH, (WIDTH as f64 / ASPECT) as usize, |x, y| {
        let mut p = DVec2::new(x * ASPECT / SIZE - left, (y - 0.5) / SIZE + 0.5);
        let edge = 0.032;
        for letter in &letters {
            if p.x > -0.5 * GAP && p.x < letter.width + 0.5 * GAP {
                return 1.0 - step_between(HALF_STROKE - edge, HALF_STROKE + edge, letter.distance(p));
            }
            p.x -= letter.width + GAP;
        }
        0.0
    })
}

/// A letter of height 1: lines through the middle of its strokes.
struct Letter {
    width: f64,
    lines: Vec<Vec<DVec2>>,
}

impl Letter {
    fn distance(&self, p: DVec2) -> f64 {
        self.lines.iter().flat_map(|line| line.windows(2)).fold(f64::INFINITY, |nearest, ends| {
            let (start, way) = (ends[0], ends[1] - ends[0]);
            let t = ((p - start).dot(way) / way.length_squared().max(1e-12)).clamp(0.0, 1.0);
            nearest.min(p.distance(start + way * t))
        })
    }
}

/// The letters of the word, and the diamond that ends it.
fn word() -> Vec<Letter> {
    let letter =
        |width, lines: &[&[DVec2]]| Letter { width, lines: lines.iter().map(|l| l.to_vec()).collect() };
    let line = |points: &[[f64; 2]]| points.iter().map(|&p| DVec2::from(p)).collect::<Vec<_>>();
    let mut s = arc([0.3, 0.7125], [0.225, 0.2125], [35.0, 270.0]);
    s.extend(arc([0.3, 0.2875], [0.225, 0.2125], [90.0, -145.0]));
    let i = line(&[[0.075, 0.075], [0.075, 0.925]]);
    let m = line(&[[0.075, 0.075], [0.115, 0.925], [0.425, 0.28], [0.735, 0.925], [0.775, 0.075]]);
    let o = arc([0.425, 0.5], [0.35, 0.425], [0.0, 360.0]);
    let mut d = line(&[[0.075, 0.075]]);
    d.extend(arc([0.26, 0.5], [0.35, 0.425], [-90.0, 90.0]));
    d.extend(line(&[[0.075, 0.925], [0.075, 0.075]]));
    let diamond = line(&[[0.12, 0.5], [0.25, 0.33], [0.38, 0.5], [0.25, 0.67], [0.12, 0.5]]);
    vec![
        letter(0.6, &[&s]),
        letter(0.15, &[&i]),
        letter(0.85, &[&m]),
        letter(0.85, &[&o]),
        letter(0.685, &[&d]),
        letter(0.5, &[&diamond]),
    ]
}

/// Points of an ellipse's arc between two angles in degrees.
fn arc(center: [f64; 2], radii: [f64; 2], degrees: [f64; 2]) -> Vec<DVec2> {
    const STEPS: i32 = 32;
    (0..=STEPS)
        .map(|i| {
            let degrees = degrees[0] + (degrees[1] - degrees[0]) * f64::from(i) / f64::from(STEPS);
            let (sin, cos) = degrees.to_radians().sin_cos();
            DVec2::from(center) + DVec2::new(cos * radii[0], sin * radii[1])
        })
        .collect()
}

/// Smooth step: 0 below `low`, 1 above `high`.
fn step_between(low: f64, high: f64, x: f64) -> f64 {
    smoothstep((x - low) / (high - low))
}
