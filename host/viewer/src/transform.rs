//! Motions by keys and the pointer: along an axis or with the picture, by the pointer or by a number that
//! is typed.

use crate::camera::Camera;
use glam::{DVec2, DVec3};
use simod_session::Motion;

/// The kind of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TransformKind {
    /// A shift.
    Move,
    /// A turn.
    Turn,
    /// A change of size.
    Scale,
}

/// Most characters that are typed.
const LONGEST: usize = 24;
/// Distance from the middle, in pixels, below which the pointer gives no angle and no size.
const LEAST: f64 = 4.0;
/// Steps of a turn in degrees, of a size, and of a shift as a part of local coordinates' unit.
const STEPS: [f64; 3] = [15.0, 0.1, 0.05];

/// A motion that is going on.
#[derive(Debug, Clone, PartialEq)]
pub struct Transform {
    kind: TransformKind,
    /// Middle of the motion, in local coordinates.
    pivot: DVec3,
    /// Length of local coordinates' unit in the model's.
    unit: f64,
    /// Axis of the motion, 0 for x; none if the motion goes with the picture.
    axis: Option<usize>,
    typed: String,
    from: DVec2,
    at: DVec2,
    /// Angle that the pointer went round the middle, in radians, as seen.
    turned: f64,
}

/// The view that a motion is seen in.
#[derive(Debug, Clone, Copy)]
pub struct ScreenView<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// The picture, in pixels.
    pub size: [f64; 2],
}

impl Transform {
    /// Begins a motion at the pointer's pixel. `pivot` is in local coordinates, of which one is `unit` of
    /// the model's.
    pub fn new(kind: TransformKind, pivot: DVec3, unit: f64, pointer: DVec2) -> Self {
        Self { kind, pivot, unit, axis: None, typed: String::new(), from: pointer, at: pointer, turned: 0.0 }
    }

    /// The kind of the motion.
    pub fn kind(&self) -> TransformKind {
        self.kind
    }

    /// Axis along or about which the motion is, 0 for x, if one was chosen.
    pub fn axis(&self) -> Option<usize> {
        self.axis
    }

    /// Chooses the axis along or about which the motion is from now on; none if it was this one.
    pub fn toggle_axis(&mut self, axis: usize) {
        self.axis = Some(axis).filter(|_| self.axis != Some(axis));
    }

    /// Adds a character to the typed number. Minus changes the number's sign, wherever it is typed; other
    /// characters than digits and a point have no effect.
    pub fn type_in(&mut self, character: char) {
        match character {
            '-' => match self.typed.strip_prefix('-') {
                Some(rest) => self.typed = rest.to_owned(),
                None => self.typed.insert(0, '-'),
            },
            '.' | ',' if !self.typed.contains('.') => self.typed.push('.'),
            '0'..='9' if self.typed.len() < LONGEST => self.typed.push(character),
            _ => {}
        }
    }

    /// Takes the last character back.
    pub fn erase(&mut self) {
        self.typed.pop();
    }

    /// Text that was typed so far.
    pub fn typed(&self) -> &str {
        &self.typed
    }

    /// Takes the pointer's next pixel.
    pub fn follow(&mut self, pixel: DVec2, seen: ScreenView<'_>) {
        if let Some((middle, _)) = seen.camera.project(self.pivot, seen.size) {
            let (a, b) = (self.at - middle, pixel - middle);
            if a.length() > LEAST && b.length() > LEAST {
                // Pixels are counted downwards.
                self.turned -= a.angle_to(b);
            }
        }
        self.at = pixel;
    }

    /// Present motion, of the model; in steps where these are wanted and nothing is typed. Nothing where
    /// the text is no number yet, or none that makes sense.
    pub fn motion(&self, seen: ScreenView<'_>, in_steps: bool) -> Option<Motion> {
        let typed = match self.typed.as_str() {
            "" => None,
            text => Some(text.parse::<f64>().ok()?),
        };
        let step = |x: f64, step: f64| if in_steps { (x / step).round() * step } else { x };
        let motion = match self.kind {
            TransformKind::Move => {
                let local = match (typed, self.axis) {
                    (Some(x), axis) => AXES[axis.unwrap_or(0)] * (x / self.unit),
                    (None, Some(axis)) => AXES[axis] * step(self.along(AXES[axis], seen), STEPS[2]),
                    (None, None) => self.across(seen).to_array().map(|x| step(x, STEPS[2])).into(),
                };
                Motion { translate: local * self.unit, ..Motion::default() }
            }
            TransformKind::Turn => {
                let back = seen.camera.axes()[2];
                let axis = self.axis.map_or(back, |axis| AXES[axis]);
                // A turn about an axis that points away has the opposite sign, as seen.
                let sign = if axis.dot(back) < 0.0 { -1.0 } else { 1.0 };
                let degrees = typed.unwrap_or_else(|| sign * step(self.turned.to_degrees(), STEPS[0]));
                Motion { axis, degrees, ..Motion::default() }
            }
            TransformKind::Scale => {
                let scale = typed.unwrap_or_else(|| step(self.size(seen), STEPS[1]));
                Motion { scale, ..Motion::default() }
            }
        };
        motion.defect().is_none().then_some(motion)
    }

    /// Shift of the pointer with the picture, at the middle's depth.
    fn across(&self, seen: ScreenView<'_>) -> DVec3 {
        let Some((_, depth)) = seen.camera.project(self.pivot, seen.size) else { return DVec3::ZERO };
        let [right, up, _] = seen.camera.axes();
        let by = (self.at - self.from) * seen.camera.pixel_length(depth, seen.size);
        right * by.x - up * by.y
    }

    /// Shift of the pointer along an axis through the middle.
    fn along(&self, axis: DVec3, seen: ScreenView<'_>) -> f64 {
        // The ray goes through the middle's pixel, moved along with the pointer.
        let Some((middle, _)) = seen.camera.project(self.pivot, seen.size) else { return 0.0 };
        let ray = seen.camera.ray(middle + self.at - self.from, seen.size);
        // The nearest point of the axis to the ray.
        let (slope, from) = (axis.dot(ray.direction), self.pivot - ray.origin);
        let apart = 1.0 - slope * slope;
        if apart < 1e-4 {
            // The axis points to the eye: nothing is to be seen along it.
            return 0.0;
        }
        (slope * ray.direction.dot(from) - axis.dot(from)) / apart
    }

    /// Ratio of the pointer's distance from the middle to its distance at the beginning.
    fn size(&self, seen: ScreenView<'_>) -> f64 {
        let Some((middle, _)) = seen.camera.project(self.pivot, seen.size) else { return 1.0 };
        (self.at.distance(middle) / self.from.distance(middle).max(LEAST)).max(0.01)
    }
}

/// The axes.
const AXES: [DVec3; 3] = DVec3::AXES;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Projection;
    use proptest::prelude::*;

    const SIZE: [f64; 2] = [1200.0, 800.0];

    fn camera(yaw: f64, pitch: f64, projection: Projection) -> Camera {
        let mut camera = Camera { projection, ..Camera::default() };
        camera.frame([DVec3::NEG_ONE, DVec3::ONE], SIZE);
        camera.orbit(yaw, pitch);
        camera
    }

    fn cameras() -> impl Strategy<Value = Camera> {
        let projection = prop_oneof![Just(Projection::Perspective), Just(Projection::Orthographic)];
        (-3.0..3.0_f64, -1.5..1.5_f64, projection).prop_map(|(yaw, pitch, p)| camera(yaw, pitch, p))
    }

    fn pivots() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-0.8..0.8_f64).prop_map(DVec3::from)
    }

    proptest! {
        /// The moved point stays under the pointer.
        #[test]
        fn it_follows_the_pointer(
            camera in cameras(),
            pivot in pivots(),
            by in prop::array::uniform2(-200.0..200.0_f64),
            unit in 0.01..100.0_f64,
        ) {
            let seen = ScreenView { camera: &camera, size: SIZE };
            let (start, by) = (DVec2::new(500.0, 300.0), DVec2::from(by));
            let mut transform = Transform::new(TransformKind::Move, pivot, unit, start);
            transform.follow(start + by, seen);
            let motion = transform.motion(seen, false).unwrap();
            let before = camera.project(pivot, SIZE).unwrap().0;
            let after = camera.project(pivot + motion.translate / unit, SIZE).unwrap().0;
            prop_assert!((after - before).distance(by) < 1e-6, "{before} {after} {by}");
        }

        /// The moved point stays under the pointer along an axis, too, as far as the axis is seen from the
        /// side.
        #[test]
        fn it_follows_along_an_axis(camera in cameras(), pivot in pivots(), axis in 0..3_usize, far in -0.5..0.5_f64) {
            let seen = ScreenView { camera: &camera, size: SIZE };
            let (from, to) = (pivot, pivot + AXES[axis] * far);
            let [from, to] = [from, to].map(|p| camera.project(p, SIZE).unwrap().0);
            prop_assume!(AXES[axis].dot(camera.ray(from, SIZE).direction).abs() < 0.98);
            let mut transform = Transform::new(TransformKind::Move, pivot, 1.0, from);
            transform.toggle_axis(axis);
            transform.follow(to, seen);
            let moved = transform.motion(seen, false).unwrap().translate;
            prop_assert!(moved.distance(AXES[axis] * far) < 1e-6, "{moved} for {far}");
        }

        /// A hand that goes round turns as far, from whatever side, and however often.
        #[test]
        fn it_turns_with_the_hand(
            camera in cameras(),
            pivot in pivots(),
            about in prop::option::of(0..3_usize),
            far in -500.0..500.0_f64,
        ) {
            let seen = ScreenView { camera: &camera, size: SIZE };
            let middle = camera.project(pivot, SIZE).unwrap().0;
            let at = |degrees: f64| middle + DVec2::from_angle(-degrees.to_radians()) * 90.0;
            let mut transform = Transform::new(TransformKind::Turn, pivot, 1.0, at(0.0));
            about.iter().for_each(|axis| transform.toggle_axis(*axis));
            for i in 1..=20 {
                transform.follow(at(far * f64::from(i) / 20.0), seen);
            }
            let motion = transform.motion(seen, false).unwrap();
            let seen_turn = if motion.axis.dot(camera.axes()[2]) < 0.0 { -far } else { far };
            prop_assert!((motion.degrees - seen_turn).abs() < 1e-6, "{} for {far}", motion.degrees);
        }
    }

    #[test]
    fn numbers_are_typed() {
        let camera = camera(0.3, 0.4, Projection::Perspective);
        let seen = ScreenView { camera: &camera, size: SIZE };
        let with = |kind: TransformKind, axis: Option<usize>, typed: &str| {
            let mut transform = Transform::new(kind, DVec3::ZERO, 4.0, DVec2::new(10.0, 10.0));
            transform.follow(DVec2::new(300.0, 500.0), seen);
            axis.iter().for_each(|axis| transform.toggle_axis(*axis));
            typed.chars().for_each(|c| transform.type_in(c));
            transform.motion(seen, false)
        };
        assert_eq!(with(TransformKind::Move, Some(1), "1.5").unwrap().translate, DVec3::Y * 1.5);
        assert_eq!(with(TransformKind::Move, None, "2-").unwrap().translate, DVec3::X * -2.0);
        assert_eq!(with(TransformKind::Move, Some(2), "-1,2,5-x").unwrap().translate, DVec3::Z * 1.25);
        let turn = with(TransformKind::Turn, Some(2), "45").unwrap();
        assert_eq!((turn.axis, turn.degrees), (DVec3::Z, 45.0));
        assert_eq!(with(TransformKind::Scale, None, "0.5").unwrap().scale, 0.5);
        for none in ["-", ".", "-."] {
            assert_eq!(with(TransformKind::Move, Some(0), none), None, "{none} is no number yet");
        }
        assert_eq!(with(TransformKind::Scale, None, "0"), None, "nothing is of no size");
        let mut erased = Transform::new(TransformKind::Scale, DVec3::ZERO, 1.0, DVec2::ZERO);
        "-2".chars().for_each(|c| erased.type_in(c));
        erased.erase();
        erased.erase();
        assert_eq!(erased.motion(seen, false).unwrap(), Motion::default());
        erased.toggle_axis(1);
        erased.toggle_axis(1);
        assert_eq!(erased.axis(), None);
    }

    #[test]
    fn a_hand_in_steps_stops_at_whole_ones() {
        let camera = camera(0.0, 0.0, Projection::Orthographic);
        let seen = ScreenView { camera: &camera, size: SIZE };
        let middle = camera.project(DVec3::ZERO, SIZE).unwrap().0;
        for kind in [TransformKind::Move, TransformKind::Turn, TransformKind::Scale] {
            let mut transform = Transform::new(kind, DVec3::ZERO, 1.0, middle + DVec2::X * 100.0);
            transform.follow(middle + DVec2::new(137.0, -81.0), seen);
            let motion = transform.motion(seen, true).unwrap();
            let whole = |x: f64, step: f64| (x / step - (x / step).round()).abs() < 1e-9;
            assert!(motion != Motion::default());
            assert!(whole(motion.degrees, 15.0) && whole(motion.scale, 0.1), "{motion:?}");
            assert!(motion.translate.to_array().iter().all(|x| whole(*x, 0.05)), "{motion:?}");
        }
    }
}
