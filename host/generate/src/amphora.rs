//! The amphora: a thrown body with a hollow neck, bands of ornament and lettering, and two rope handles.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::curve::BSpline;
use super::fade::fade;
use super::layout::SurfacePatch;
use super::noise::noise;
use super::ornament;
use super::sweep::{Raised, Relief, Site, Sweep, SweepAxis};
use super::tile::ReliefTile;

/// Control points of the body's profile: distance from the axis, height. From the middle of the underside up
/// the outside, over the lip, down the inside of the neck to the middle of its floor.
#[rustfmt::skip]
const BODY: [[f64; 2]; 40] = [
    [-0.08, 0.05], [0.0, 0.05], [0.08, 0.05], [0.16, 0.045], [0.20, 0.005], [0.235, 0.0], [0.265, 0.015],
    [0.268, 0.05], [0.215, 0.085], [0.14, 0.105], [0.112, 0.14], [0.122, 0.18], [0.175, 0.24],
    [0.29, 0.36], [0.43, 0.53], [0.55, 0.73], [0.615, 0.93], [0.625, 1.12], [0.565, 1.29], [0.44, 1.41],
    [0.30, 1.475], [0.215, 1.53], [0.185, 1.61], [0.175, 1.71], [0.178, 1.81], [0.205, 1.88],
    [0.262, 1.91], [0.295, 1.935], [0.298, 1.97], [0.285, 2.0], [0.25, 2.005], [0.21, 1.975],
    [0.165, 1.90], [0.14, 1.81], [0.135, 1.71], [0.14, 1.61], [0.125, 1.53], [0.06, 1.51], [0.0, 1.51],
    [-0.06, 1.51],
];

/// Control points of a handle's axis, from within the neck's wall to within the shoulder.
#[rustfmt::skip]
const HANDLE: [[f64; 2]; 10] = [
    [0.08, 1.775], [0.16, 1.775], [0.25, 1.80], [0.36, 1.835], [0.465, 1.815], [0.52, 1.71], [0.53, 1.59],
    [0.515, 1.46], [0.475, 1.33], [0.43, 1.22],
];

const TERRACOTTA: [f64; 3] = [190.0, 110.0, 70.0];
const DARK: [f64; 3] = [52.0, 38.0, 34.0];
const CREAM: [f64; 3] = [232.0, 200.0, 158.0];

/// The body and both handles.
pub(super) fn amphora() -> Vec<Box<dyn SurfacePatch>> {
    vec![Box::new(body()), Box::new(handle(false)), Box::new(handle(true))]
}

fn body() -> Sweep<BodyRelief> {
    let profile = BSpline::new(BODY.map(DVec2::from).to_vec());
    let relief = BodyRelief::new(&profile);
    Sweep { axis: SweepAxis::Straight, profile, relief }
}

/// One handle; its flat ends lie within the body.
fn handle(turned: bool) -> Sweep<RopeRelief> {
    let curve = BSpline::new(HANDLE.map(DVec2::from).to_vec());
    let end = curve.length();
    // Thicker at both ends, where the potter presses it on.
    let half =
        [[-0.02, 0.0], [0.0, 0.0], [0.02, 0.0], [0.05, 0.0], [0.056, 0.012], [0.05, 0.04], [0.041, 0.09]];
    let mut points = half.to_vec();
    points.extend([0.3, 0.5, 0.7].map(|part| [0.037, part * end]));
    points.extend(half.iter().rev().map(|[radius, way]| [*radius, end - way]));
    let profile = BSpline::new(points.into_iter().map(DVec2::from).collect());
    let relief = RopeRelief { length: profile.length() };
    Sweep { axis: SweepAxis::Bent { curve, turned }, profile, relief }
}

/// A band of ornament around the body.
struct Band {
    /// Start and end, as distances along the profile.
    range: [f64; 2],
    /// Number of tiles around the body, and across the band.
    repeats: [f64; 2],
    /// Height of the ornament; negative where it is engraved.
    depth: f64,
    tile: ReliefTile,
    /// Colours of the ground and of the ornament.
    colors: [[f64; 3]; 2],
}

impl Band {
    /// Adds the ornament; returns how much of its colour to show.
    fn add(&self, raised: &mut Raised, site: &Site) -> f64 {
        // The ornament ends softly where the band cuts it.
        const FADE: f64 = 0.06;
        let length = self.range[1] - self.range[0];
        let v = (site.distance - self.range[0]) / length;
        let (edge, sign) = if v < 0.5 { (v, 1.0) } else { (1.0 - v, -1.0) };
        let (fade, slope) = fade(edge, FADE);
        let fade_slope = sign * slope;

        // Seen from outside, turns grow to the left.
        let (value, by_x, by_y) = self.tile.sample(-site.turn * self.repeats[0], v * self.repeats[1]);
        raised.height += self.depth * value * fade;
        raised.along += self.depth * (by_y * self.repeats[1] * fade + value * fade_slope) / length;
        raised.around -= self.depth * by_x * fade * self.repeats[0] / (TAU * site.radius);
        value * fade
    }
}

struct BodyRelief {
    bands: Vec<Band>,
    /// Distances along the profile where raised fillets separate the bands.
    fillets: Vec<f64>,
    /// Distances between which the body is glazed dark, beside the bands.
    glazed: [[f64; 2]; 3],
}

impl BodyRelief {
    fn new(profile: &BSpline) -> Self {
        let lip = distance_at_height(profile, 1.999);
        let at = |height: f64| distance_at_height(profile, height);
        let band = |low: f64, high: f64, around: f64, across: f64, depth: f64, tile: ReliefTile, colors| {
            Band { range: [at(low), at(high)], repeats: [around, across], depth, tile, colors }
        };
        let bands = vec![
            band(0.21, 0.56, 30.0, 1.0, 0.017, ornament::tongue(), [DARK, TERRACOTTA]),
            band(0.60, 0.70, 90.0, 4.0, 0.005, ornament::weave(), [DARK, TERRACOTTA]),
            band(0.73, 0.88, 24.0, 1.0, 0.008, ornament::meander(), [TERRACOTTA, DARK]),
            band(0.915, 1.165, 4.0, 1.0, -0.010, ornament::lettering(), [DARK, CREAM]),
            band(1.20, 1.29, 38.0, 1.0, 0.006, ornament::meander(), [TERRACOTTA, DARK]),
            band(1.32, 1.47, 48.0, 3.0, 0.006, ornament::scales(), [DARK, TERRACOTTA]),
            band(1.60, 1.84, 24.0, 5.0, 0.004, ornament::scales(), [DARK, TERRACOTTA]),
        ];
        let fillets =
            [0.58, 0.717, 0.895, 1.185, 1.302, 1.515, 1.535, 1.565, 1.875].into_iter().map(at).collect();
        let glazed = [[0.0, at(0.19)], [at(0.895), at(1.185)], [at(1.885), lip + 0.06]];
        Self { bands, fillets, glazed }
    }
}

/// Distance along the profile at which the profile first reaches a height, coming from the foot.
fn distance_at_height(profile: &BSpline, height: f64) -> f64 {
    const STEPS: i32 = 2000;
    let step = profile.length() / f64::from(STEPS);
    // The underside lies higher than the foot's ring, so the search starts beyond it.
    let under = (0..STEPS).find(|&i| profile.point(step * f64::from(i)).position.x > 0.24).unwrap_or(0);
    let above = (under..STEPS).find(|&i| profile.point(step * f64::from(i)).position.y >= height);
    let (mut low, mut high) = match above {
        Some(i) => (step * f64::from(i - 1), step * f64::from(i)),
        None => return profile.length(),
    };
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if profile.point(middle).position.y < height { low = middle } else { high = middle }
    }
    high
}

impl Relief for BodyRelief {
    fn raise(&self, site: &Site) -> (Raised, [u8; 3]) {
        let mut raised = Raised::default();
        let grain = add_grain(&mut raised, site);

        for fillet in &self.fillets {
            const WIDTH: f64 = 0.0055;
            let x = (site.distance - fillet) / WIDTH;
            if x.abs() < 6.0 {
                let ridge = 0.007 * (-x * x).exp();
                raised.height += ridge;
                raised.along -= ridge * 2.0 * x / WIDTH;
            }
        }

        let within = |range: &[f64; 2]| range[0] <= site.distance && site.distance <= range[1];
        let color = if let Some(band) = self.bands.iter().find(|band| within(&band.range)) {
            let share = band.add(&mut raised, site);
            mix(band.colors[0], band.colors[1], share)
        } else if self.glazed.iter().any(within) {
            DARK
        } else {
            TERRACOTTA
        };
        (raised, shade(color, grain))
    }
}

/// Three strands twisted to a rope, each twisted from fibres the other way round.
struct RopeRelief {
    length: f64,
}

impl Relief for RopeRelief {
    fn raise(&self, site: &Site) -> (Raised, [u8; 3]) {
        const STRANDS: f64 = 3.0;
        const STRANDS_PER_LENGTH: f64 = 19.0;
        const FIBRES: f64 = 24.0;
        const FIBRES_PER_LENGTH: f64 = 80.0;

        let mut raised = Raised::default();
        let grain = add_grain(&mut raised, site);

        // Everything fades out before the flat caps.
        const FADE: f64 = 0.05;
        let (edge, sign) = if site.distance < 0.5 * self.length {
            (site.distance - 0.05, 1.0)
        } else {
            (self.length - site.distance - 0.05, -1.0)
        };
        let (fade, slope) = fade(edge, FADE);
        let fade_slope = sign * slope;
        if fade == 0.0 {
            return (raised, shade(DARK, grain));
        }

        let phase = STRANDS * site.turn - STRANDS_PER_LENGTH * site.distance;
        let (sin, cos) = (0.5 * TAU * phase).sin_cos();
        // |cos| has one arch per strand; the small constant rounds the groove between them.
        let arch = (cos * cos + 0.015).sqrt();
        let arch_slope = -0.5 * TAU * cos * sin / arch;
        let fibre_phase = TAU * (FIBRES * site.turn + FIBRES_PER_LENGTH * site.distance);
        let (fibre_sin, fibre_cos) = fibre_phase.sin_cos();
        const HEIGHT: f64 = 0.016;
        const FIBRE_HEIGHT: f64 = 0.0007;

        let value = HEIGHT * (arch - 0.6) + FIBRE_HEIGHT * fibre_cos;
        let by_turn = HEIGHT * arch_slope * STRANDS - FIBRE_HEIGHT * fibre_sin * TAU * FIBRES;
        let by_distance =
            -HEIGHT * arch_slope * STRANDS_PER_LENGTH - FIBRE_HEIGHT * fibre_sin * TAU * FIBRES_PER_LENGTH;
        raised.height += fade * value;
        raised.along += fade * by_distance + fade_slope * value;
        raised.around += fade * by_turn / (TAU * site.radius);
        let groove = fade * (1.0 - arch.min(1.0));
        (raised, shade(mix(TERRACOTTA, DARK, 0.25 + 0.75 * groove), grain))
    }
}

/// Adds the faint unevenness of fired clay, from the potter's hand down to the grain; returns it, in [-1, 1].
fn add_grain(raised: &mut Raised, site: &Site) -> f64 {
    const OCTAVES: [(f64, f64); 4] = [(2.7, 0.004), (17.0, 0.0008), (61.0, 0.0002), (190.0, 0.00006)];
    let mut grain = 0.0;
    for (i, (frequency, amplitude)) in OCTAVES.into_iter().enumerate() {
        let shift = DVec3::new(0.37, 0.71, 0.13) * (i + 1) as f64;
        let (value, gradient) = noise(site.position * frequency + shift);
        raised.add_field(amplitude * value, gradient * (amplitude * frequency), site);
        grain += 0.25 * value;
    }
    grain
}

fn mix(a: [f64; 3], b: [f64; 3], share: f64) -> [f64; 3] {
    let share = share.clamp(0.0, 1.0);
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * share)
}

fn shade(color: [f64; 3], grain: f64) -> [u8; 3] {
    color.map(|c| (c * (1.0 + 0.12 * grain)).round().clamp(0.0, 255.0) as u8)
}

#[cfg(test)]
mod tests {
    use super::super::sweep::worst_normal;
    use super::*;

    #[test]
    fn normals_are_those_of_the_surface() {
        assert!(worst_normal(&handle(false)) < 1e-4);
        assert!(worst_normal(&handle(true)) < 1e-4);
        assert!(worst_normal(&body()) < 1e-4);
    }
}
