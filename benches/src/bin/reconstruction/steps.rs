//! Maps that change within a few samples, or at once: how far a method is off there, and how far it
//! overshoots.

use glam::{DQuat, DVec3};
use rayon::prelude::*;
use simod_benches::peers::Peer;
use simod_benches::process::Result;
use simod_benches::{TILTED, error_figure, head, row};

use crate::Arguments;
use crate::method::Method;
use crate::scene::{Scene, positions_of};

const METHODS: [Method; 4] = [
    Method::Peer(Peer::InverseDistance),
    Method::Peer(Peer::AffineLeastSquares),
    Method::SIMOD[0],
    Method::SIMOD[1],
];

/// Widths of the ramps, in spacings of the samples.
const WIDTHS: [f64; 6] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0];
/// Radius of a stroke, in the same.
const STROKE: f64 = 2.0;
/// Length of all displacements, as a fraction of the diagonal.
const HEIGHT: f64 = 0.05;
/// Angle by which a part of the model is turned, in degrees.
const TURN: f64 = 10.0;

/// Change of the model that has a step.
#[derive(Clone, Copy)]
enum Change {
    /// The displacement grows linearly across a plane, over so many spacings.
    Ramp(f64),
    /// The displacement is 1 in the middle of a ball, and falls to 0 at its surface as (1 − r²)².
    Stroke,
    /// The part on one side of a plane is turned and moved, the other side stays.
    RigidPart,
}

impl Change {
    fn all() -> impl Iterator<Item = Self> {
        WIDTHS.into_iter().map(Self::Ramp).chain([Self::Stroke, Self::RigidPart])
    }

    fn name(self) -> String {
        match self {
            Self::Ramp(1.0) => "ramp over 1 spacing".to_owned(),
            Self::Ramp(width) => format!("ramp over {width} spacings"),
            Self::Stroke => format!("stroke of radius {STROKE} spacings"),
            Self::RigidPart => "a part moved rigidly".to_owned(),
        }
    }

    /// Distance from the change's middle or border within which a vertex is near it, in spacings.
    fn reach(self) -> f64 {
        match self {
            Self::Ramp(width) => width.max(2.0) + 2.0,
            Self::Stroke => STROKE.max(2.0) + 2.0,
            Self::RigidPart => 4.0,
        }
    }
}

/// Place of a change, in the model's coordinates.
struct Place {
    /// A point of the plane, and its unit normal.
    center: DVec3,
    normal: DVec3,
    /// The middle of the stroke.
    stroke: DVec3,
    /// Length of the displacement (along [`TILTED`]).
    height: f64,
    spacing: f64,
}

impl Place {
    fn from_scene(scene: &Scene) -> Self {
        let bounds = &scene.sampled.bounds;
        Self {
            center: bounds.center(),
            normal: DVec3::new(0.2, 0.9, 0.3).normalize_or_zero(),
            stroke: scene.front(),
            height: HEIGHT * bounds.diagonal(),
            spacing: scene.spacing(),
        }
    }

    /// The signed distance from the plane.
    fn side(&self, p: DVec3) -> f64 {
        (p - self.center).dot(self.normal)
    }

    fn image(&self, change: Change, p: DVec3) -> DVec3 {
        match change {
            Change::Ramp(width) => {
                let share = (self.side(p) / (width * self.spacing) + 0.5).clamp(0.0, 1.0);
                p + TILTED * (share * self.height)
            }
            Change::Stroke => {
                let radius = STROKE * self.spacing;
                let square = (p.distance_squared(self.stroke) / (radius * radius)).min(1.0);
                p + TILTED * ((1.0 - square) * (1.0 - square) * self.height)
            }
            Change::RigidPart if self.side(p) > 0.0 => self.moved_part(p),
            Change::RigidPart => p,
        }
    }

    /// The image of a point that belongs to the part that moves: turned about an axis in the plane.
    fn moved_part(&self, p: DVec3) -> DVec3 {
        let turn = DQuat::from_axis_angle(self.normal.any_orthonormal_vector(), TURN.to_radians());
        self.center + turn * (p - self.center) + TILTED * self.height
    }

    /// The distance from the middle of the step, or the border of the stroke.
    fn distance(&self, change: Change, p: DVec3) -> f64 {
        match change {
            Change::Stroke => (p.distance(self.stroke) - STROKE * self.spacing).abs(),
            _ => self.side(p).abs(),
        }
    }

    /// Distance of a point's image from all images that the map gives to any point: along the
    /// displacement as a part of its length; for a part that moves along an axis, beyond both images that the
    /// point might have.
    fn overshoot(&self, change: Change, p: DVec3, image: DVec3) -> f64 {
        match change {
            Change::RigidPart => {
                let other = self.moved_part(p);
                (p.min(other) - image).max(image - p.max(other)).max_element().max(0.0)
            }
            _ => {
                let along = (image - p).dot(TILTED);
                (along - self.height).max(-along).max(0.0)
            }
        }
    }

    /// Largest displacement, by which the overshoot is measured.
    fn largest_displacement(&self, change: Change, positions: &[DVec3]) -> f64 {
        match change {
            Change::RigidPart => {
                positions.par_iter().map(|p| p.distance(self.image(change, *p))).reduce(|| 0.0, f64::max)
            }
            _ => self.height,
        }
    }
}

/// Figures of a result.
struct Outcome {
    rms: f64,
    worst: f64,
    overshoot: f64,
}

/// A figure of a table.
type Figure = fn(&Outcome) -> String;

/// Measures, and prints tables.
pub fn measure(arguments: &Arguments) -> Result<()> {
    let Arguments { model, small_vertices, small_samples, folder, .. } = arguments;
    let scene = Scene::of_file_or_amphora(model.as_deref(), *small_vertices, *small_samples, folder)?;
    let place = Place::from_scene(&scene);
    let mut outcomes = Vec::new();
    for change in Change::all() {
        let of_methods = METHODS.iter().map(|method| outcome(&scene, &place, change, *method));
        outcomes.push(of_methods.collect::<Result<Vec<_>>>()?);
    }
    let diagonal = scene.sampled.bounds.diagonal();
    println!(
        "{}; a spacing is {:.1e} of the diagonal, the displacement {HEIGHT}",
        scene.title(),
        place.spacing / diagonal
    );
    let figures: [(&str, Figure); 3] = [
        ("rms error near the step, as a fraction of the diagonal", |o| error_figure(o.rms)),
        ("worst error", |o| error_figure(o.worst)),
        ("overshoot, as a part of the displacement", |o| format!("{:.3}", o.overshoot)),
    ];
    for (title, figure) in figures {
        let titles = [title].into_iter().chain(METHODS.map(Method::name));
        println!("\n{}", head(&titles.collect::<Vec<_>>()));
        for (change, outcomes) in Change::all().zip(&outcomes) {
            println!("{}", row([change.name()].into_iter().chain(outcomes.iter().map(figure))));
        }
    }
    Ok(())
}

fn outcome(scene: &Scene, place: &Place, change: Change, method: Method) -> Result<Outcome> {
    scene.transfer(method, &scene.deform(|p| place.image(change, p)))?;
    let images = positions_of(scene.result()?.as_ref())?;
    let diagonal = scene.sampled.bounds.diagonal();
    let (mut squares, mut near, mut worst, mut overshoot) = (0.0, 0u64, 0.0f64, 0.0f64);
    for (p, image) in scene.positions.iter().zip(images).filter(|(p, _)| p.is_finite()) {
        let error = image.distance(place.image(change, *p)) / diagonal;
        worst = worst.max(error);
        overshoot = overshoot.max(place.overshoot(change, *p, image));
        if place.distance(change, *p) <= change.reach() * place.spacing {
            squares += error * error;
            near += 1;
        }
    }
    let displacement = place.largest_displacement(change, &scene.positions);
    Ok(Outcome { rms: (squares / near as f64).sqrt(), worst, overshoot: overshoot / displacement })
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACE: Place =
        Place { center: DVec3::ONE, normal: DVec3::Y, stroke: DVec3::ZERO, height: 0.5, spacing: 0.1 };

    #[test]
    fn a_ramp_reaches_nothing_and_all() {
        let ramp = Change::Ramp(4.0);
        let share = |y: f64| {
            let p = DVec3::new(3.0, 1.0 + y, -2.0);
            (PLACE.image(ramp, p) - p).dot(TILTED) / PLACE.height
        };
        for (y, expected) in [(-0.3, 0.0), (-0.2, 0.0), (-0.1, 0.25), (0.0, 0.5), (0.2, 1.0), (0.3, 1.0)] {
            assert!((share(y) - expected).abs() < 1e-12, "{y}");
        }
    }

    #[test]
    fn what_lies_between_does_not_overshoot() {
        let p = DVec3::new(0.0, 1.5, 0.0);
        for (part, expected) in [(0.0, 0.0), (0.4, 0.0), (1.0, 0.0), (1.2, 0.1), (-0.2, 0.1)] {
            let image = p + TILTED * (part * PLACE.height);
            assert!((PLACE.overshoot(Change::Ramp(1.0), p, image) - expected).abs() < 1e-12, "{part}");
            let image = p.lerp(PLACE.moved_part(p), part);
            assert_eq!(PLACE.overshoot(Change::RigidPart, p, image) > 1e-12, expected > 0.0, "{part}");
        }
    }
}
