//! The view of a picture.

use glam::{DVec3, Vec3};

/// Half the vertical angle of view; narrow, as in product photography.
const HALF_FIELD: f64 = 14.0 * std::f64::consts::PI / 180.0;

/// A perspective camera that looks at a box, with +y up in the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PictureCamera {
    position: DVec3,
    right: DVec3,
    up: DVec3,
    forward: DVec3,
    target: DVec3,
    /// Radius of the sphere around the target that fits in the picture.
    radius: f64,
    /// Tangents of half the angles of view, horizontal and vertical.
    tangents: [f64; 2],
}

impl PictureCamera {
    /// Camera that looks at the middle of a box (its lowest and highest corners) so that the box fills a
    /// picture of the given aspect (width by height), from a direction: `yaw` turns to the right about +y
    /// from +z, `pitch` looks down, in radians.
    pub fn frame(bounds: [DVec3; 2], yaw: f64, pitch: f64, aspect: f64) -> Self {
        let [low, high] = bounds;
        let target = 0.5 * (low + high);
        let target = if target.is_finite() { target } else { DVec3::ZERO };
        let radius = 0.5 * (high - low).length();
        let radius = if radius.is_finite() && radius > 0.0 { radius } else { 1.0 };
        let aspect = if aspect.is_finite() && aspect > 0.0 { aspect } else { 1.0 };

        let pitch = pitch.clamp(-1.55, 1.55);
        let ((sin_yaw, cos_yaw), (sin_pitch, cos_pitch)) = (yaw.sin_cos(), pitch.sin_cos());
        let forward = -DVec3::new(sin_yaw * cos_pitch, sin_pitch, cos_yaw * cos_pitch);
        let right = DVec3::new(cos_yaw, 0.0, -sin_yaw);
        let up = right.cross(forward);

        let tangent = HALF_FIELD.tan();
        let tangents = [tangent * aspect, tangent];

        // The least distance at which every corner of the box lies within the margins.
        const MARGIN: f64 = 1.04;
        let mut distance = 0.0f64;
        for corner in 0..8 {
            let pick = |bit: usize, low: f64, high: f64| if corner >> bit & 1 == 0 { low } else { high };
            let corner = DVec3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z));
            let v = corner - target;
            let toward = v.dot(forward);
            let needed = (v.dot(right).abs() * MARGIN / tangents[0])
                .max(v.dot(up).abs() * MARGIN / tangents[1])
                - toward;
            if needed.is_finite() {
                distance = distance.max(needed);
            }
        }
        let distance = if distance > 0.0 { distance } else { radius / tangent };
        Self { position: target - forward * distance, right, up, forward, target, radius, tangents }
    }

    /// Returns this view of a part of the picture, from as far away: the part around a point, or the middle,
    /// `part` as wide and high as the whole.
    pub(super) fn crop(self, around: Option<DVec3>, part: f64) -> Self {
        let way = around.map_or(DVec3::ZERO, |point| point - self.target);
        let aside = way - way.dot(self.forward) * self.forward;
        Self { position: self.position + aside, tangents: self.tangents.map(|t| part * t), ..self }
    }

    /// The eye's position.
    pub fn position(&self) -> DVec3 {
        self.position
    }

    /// Distance of the eye from the target.
    pub(super) fn distance(&self) -> f64 {
        self.position.distance(self.target)
    }

    /// Returns this view from this distance, where the view was nearer by more than rounding.
    pub(super) fn at_least(self, distance: f64) -> Self {
        if self.distance() >= distance * (1.0 - 1e-9) {
            return self;
        }
        Self { position: self.target - self.forward * distance, ..self }
    }

    /// Position of a point in a picture of the given size: pixels from the top left corner; none where the
    /// point is not before the camera.
    pub fn project(&self, p: DVec3, width: u32, height: u32) -> Option<[f32; 2]> {
        let (lens, view) = (self.lens(width, height), self.to_view(p));
        (view.is_finite() && view.z > lens.near).then(|| lens.project(view))
    }

    /// The point in the middle of the picture, which is the middle of the framed box.
    pub(super) fn target(&self) -> DVec3 {
        self.target
    }

    /// Radius of the framed box.
    pub(super) fn radius(&self) -> f64 {
        self.radius
    }

    /// View coordinates: right, up, and forward.
    pub(super) fn to_view(self, p: DVec3) -> Vec3 {
        self.direction_to_view(p - self.position).as_vec3()
    }

    pub(super) fn direction_to_view(self, v: DVec3) -> DVec3 {
        DVec3::new(v.dot(self.right), v.dot(self.up), v.dot(self.forward))
    }

    /// The direction in the world of a direction in view coordinates.
    pub(super) fn to_world(self, v: DVec3) -> DVec3 {
        self.right * v.x + self.up * v.y + self.forward * v.z
    }

    /// The lens for a picture of so many pixels.
    pub(super) fn lens(&self, width: u32, height: u32) -> Lens {
        let scale =
            [0.5 * width as f32 / self.tangents[0] as f32, 0.5 * height as f32 / self.tangents[1] as f32];
        Lens {
            center: [0.5 * width as f32, 0.5 * height as f32],
            scale,
            inverse: scale.map(f32::recip),
            near: (1e-4 * self.radius) as f32,
        }
    }
}

/// The map between view coordinates and pixels.
#[derive(Clone, Copy)]
pub(super) struct Lens {
    pub center: [f32; 2],
    /// Pixels per unit at distance 1.
    pub scale: [f32; 2],
    /// Inverse of the scale: rays are asked for more often than anything else.
    inverse: [f32; 2],
    /// Nearer points are not drawn.
    pub near: f32,
}

impl Lens {
    /// Pixel coordinates of a point in view coordinates; y grows downwards.
    pub fn project(&self, v: Vec3) -> [f32; 2] {
        [self.center[0] + self.scale[0] * v.x / v.z, self.center[1] - self.scale[1] * v.y / v.z]
    }

    /// The projection of a point in double precision, for what may lie far outside of the picture.
    pub fn project_exactly(&self, v: DVec3) -> [f64; 2] {
        let [center, scale] = [self.center, self.scale].map(|xy| xy.map(f64::from));
        [center[0] + scale[0] * v.x / v.z, center[1] - scale[1] * v.y / v.z]
    }

    /// The point at depth 1 that a pixel's middle shows.
    pub fn ray(&self, x: usize, y: usize) -> Vec3 {
        Vec3::new(
            (x as f32 + 0.5 - self.center[0]) * self.inverse[0],
            (self.center[1] - y as f32 - 0.5) * self.inverse[1],
            1.0,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_whole_box_is_in_the_picture() {
        let (low, high) = (DVec3::new(-3.0, 10.0, 0.0), DVec3::new(5.0, 11.0, 2.0));
        for i in 0..40 {
            let t = f64::from(i);
            let camera = PictureCamera::frame([low, high], t * 0.7, (t * 0.3).sin(), 0.5 + t * 0.05);
            for corner in [low, high, DVec3::new(low.x, high.y, low.z), DVec3::new(high.x, low.y, low.z)] {
                let [x, y] = camera.project(corner, 200, 100).unwrap();
                assert!((0.0..200.0).contains(&x) && (0.0..100.0).contains(&y), "{x} {y}");
            }
        }
    }

    #[test]
    fn a_crop_has_its_point_in_the_middle_and_everything_larger() {
        let camera = PictureCamera::frame([DVec3::splat(-1.0), DVec3::new(1.0, 3.0, 2.0)], 0.7, 0.3, 1.5);
        let point = DVec3::new(0.5, 2.5, -0.75);
        let crop = camera.crop(Some(point), 0.25);
        let [x, y] = crop.project(point, 300, 200).unwrap();
        assert!((x - 150.0).abs() < 1e-2 && (y - 100.0).abs() < 1e-2, "{x} {y}");
        let wide = |camera: &PictureCamera| {
            let [a, b] = [-0.1, 0.1].map(|d| camera.project(point + d * camera.right, 300, 200).unwrap()[0]);
            b - a
        };
        assert!((wide(&crop) / wide(&camera) - 4.0).abs() < 1e-2);
        assert_eq!(camera.crop(None, 1.0), camera);
    }

    #[test]
    fn degenerate_boxes_give_a_camera() {
        for bounds in [[DVec3::ZERO; 2], [DVec3::NAN; 2], [DVec3::INFINITY, DVec3::NEG_INFINITY]] {
            assert!(PictureCamera::frame(bounds, 0.0, 0.0, f64::NAN).position().is_finite());
        }
    }
}
