//! Camera that goes round a point, in local coordinates, where models are of about unit size.
//!
//! The camera's direction is two angles about an upright axis, so the camera never rolls, and stops above
//! and below. Pixels are counted from the top left of the picture; their middles are at halves.

use glam::{DMat4, DQuat, DVec2, DVec3, DVec4};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI};

/// The axis of the model that points up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Up {
    /// Upright axis of most programs for pictures.
    #[default]
    Y,
    /// Upright axis of most programs for measuring and building.
    Z,
}

/// The projection of depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Projection {
    /// Far things look smaller.
    #[default]
    Perspective,
    /// Sizes look the same at all depths.
    Orthographic,
}

/// Standard views, each with a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "they say it")]
pub enum Standard {
    Front,
    Back,
    Left,
    Right,
    Top,
    Bottom,
    Isometric,
}

/// A camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Camera {
    /// The point that the camera goes round.
    pub target: DVec3,
    /// Angle from the front towards the right, in radians.
    pub yaw: f64,
    /// Angle from the horizon upwards, in radians, at most a right angle.
    pub pitch: f64,
    /// Distance from the target to the eye.
    pub distance: f64,
    /// The angle from the picture's lower edge to its upper one, radians.
    pub fov: f64,
    /// The projection of depth.
    pub projection: Projection,
    /// The axis that points up.
    pub up: Up,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            target: DVec3::ZERO,
            yaw: 0.5,
            pitch: 0.3,
            distance: 3.0,
            fov: 0.6,
            projection: Projection::default(),
            up: Up::default(),
        }
    }
}

/// Ray through the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// The point where the ray begins.
    pub origin: DVec3,
    /// Direction of the ray, of length 1.
    pub direction: DVec3,
}

/// Nearest and farthest distance that a camera gets from its target.
const DISTANCES: [f64; 2] = [1e-6, 1e4];

impl Camera {
    /// Axes of the camera, to the right, upwards, and towards the eye: of length 1, at right angles,
    /// right-handed.
    pub fn axes(&self) -> [DVec3; 3] {
        let (sin, cos) = self.yaw.sin_cos();
        let right = DVec3::new(cos, 0.0, -sin);
        let level = DVec3::new(sin, 0.0, cos);
        let back = level * self.pitch.cos() + DVec3::Y * self.pitch.sin();
        let upright = match self.up {
            Up::Y => DQuat::IDENTITY,
            Up::Z => DQuat::from_rotation_x(FRAC_PI_2),
        };
        [right, back.cross(right), back].map(|axis| upright * axis)
    }

    /// The eye's position.
    pub fn eye(&self) -> DVec3 {
        self.target + self.axes()[2] * self.distance
    }

    /// Map from local coordinates to those of the eye: x to the right, y upwards, z towards the eye.
    pub fn view(&self) -> DMat4 {
        let [right, up, back] = self.axes();
        let rows = DMat4::from_cols(right.extend(0.0), up.extend(0.0), back.extend(0.0), DVec4::W);
        rows.transpose() * DMat4::from_translation(-self.eye())
    }

    /// Map from the eye's coordinates to the picture's, right-handed, with depths from 0 at `near` to 1 at
    /// `far`.
    pub fn projection(&self, size: [f64; 2], [near, far]: [f64; 2]) -> DMat4 {
        let aspect = aspect(size);
        let depth = 1.0 / (near - far);
        match self.projection {
            Projection::Perspective => {
                let y = 1.0 / (0.5 * self.fov).tan();
                DMat4::from_cols(
                    DVec4::X * (y / aspect),
                    DVec4::Y * y,
                    DVec4::new(0.0, 0.0, far * depth, -1.0),
                    DVec4::Z * (near * far * depth),
                )
            }
            Projection::Orthographic => {
                let y = 1.0 / self.half_height();
                DMat4::from_cols(
                    DVec4::X * (y / aspect),
                    DVec4::Y * y,
                    DVec4::Z * depth,
                    DVec4::new(0.0, 0.0, near * depth, 1.0),
                )
            }
        }
    }

    /// View and projection in one map, with depths around a box between two corners.
    pub fn view_projection(&self, size: [f64; 2], bounds: [DVec3; 2]) -> DMat4 {
        self.projection(size, self.near_far(bounds)) * self.view()
    }

    /// Half of the picture's height at the target.
    fn half_height(&self) -> f64 {
        self.distance * (0.5 * self.fov).tan()
    }

    /// Depths of the near and the far plane around a box between two corners. In perspective the nearer one
    /// is positive.
    pub fn near_far(&self, [min, max]: [DVec3; 2]) -> [f64; 2] {
        let (center, radius) = (0.5 * (min + max), (0.5 * (max - min).length()).max(1e-6));
        let (center, radius) =
            if center.is_finite() && radius.is_finite() { (center, radius) } else { (self.target, 1.0) };
        let depth = (self.eye() - center).dot(self.axes()[2]);
        let (near, far) = (depth - 1.01 * radius, depth + 1.01 * radius);
        match self.projection {
            Projection::Orthographic => [near, far],
            Projection::Perspective => {
                let far = far.max(1e-3 * radius);
                [near.max(1e-4 * far).max(1e-9), far]
            }
        }
    }

    /// The ray of a pixel. In orthographic projection it begins at the eye's depth, and goes back from there
    /// as well.
    pub fn ray(&self, pixel: DVec2, size: [f64; 2]) -> Ray {
        let [right, up, back] = self.axes();
        let x = (2.0 * pixel.x / size[0].max(1.0) - 1.0) * aspect(size);
        let y = 1.0 - 2.0 * pixel.y / size[1].max(1.0);
        match self.projection {
            Projection::Perspective => {
                let t = (0.5 * self.fov).tan();
                let direction = right * (x * t) + up * (y * t) - back;
                Ray { origin: self.eye(), direction: direction.normalize_or(-back) }
            }
            Projection::Orthographic => {
                let half = self.half_height();
                Ray { origin: self.eye() + right * (x * half) + up * (y * half), direction: -back }
            }
        }
    }

    /// Pixel that shows a point, and the point's depth before the eye; nothing for points behind the eye in
    /// perspective.
    pub fn project(&self, p: DVec3, size: [f64; 2]) -> Option<(DVec2, f64)> {
        let [right, up, back] = self.axes();
        let d = p - self.eye();
        let depth = -d.dot(back);
        let half = match self.projection {
            Projection::Perspective if depth <= 0.0 => return None,
            Projection::Perspective => depth * (0.5 * self.fov).tan(),
            Projection::Orthographic => self.half_height(),
        };
        let (x, y) = (d.dot(right) / (half * aspect(size)), d.dot(up) / half);
        let pixel = DVec2::new(0.5 * (x + 1.0) * size[0].max(1.0), 0.5 * (1.0 - y) * size[1].max(1.0));
        pixel.is_finite().then_some((pixel, depth))
    }

    /// Length of a pixel's side at a depth, in local coordinates.
    pub fn pixel_length(&self, depth: f64, size: [f64; 2]) -> f64 {
        let half = match self.projection {
            Projection::Perspective => depth.max(0.0) * (0.5 * self.fov).tan(),
            Projection::Orthographic => self.half_height(),
        };
        2.0 * half / size[1].max(1.0)
    }

    /// Goes round the target by two angles, radians.
    pub fn orbit(&mut self, yaw: f64, pitch: f64) {
        self.yaw = (self.yaw + yaw + PI).rem_euclid(2.0 * PI) - PI;
        self.pitch = (self.pitch + pitch).clamp(-FRAC_PI_2, FRAC_PI_2);
    }

    /// Moves along the picture, so that things as deep as the target follow the pointer, which moved by so
    /// many pixels.
    pub fn pan(&mut self, pixels: DVec2, size: [f64; 2]) {
        let length = self.pixel_length(self.distance, size);
        let [right, up, _] = self.axes();
        self.target += (up * pixels.y - right * pixels.x) * length;
    }

    /// Makes all larger by a factor. The anchor, a point under the pointer, stays where it is in the
    /// picture.
    pub fn zoom(&mut self, factor: f64, anchor: DVec3) {
        let distance = (self.distance / factor).clamp(DISTANCES[0], DISTANCES[1]);
        // All of the camera comes nearer to the anchor, which stays in the same direction.
        self.target = anchor + (self.target - anchor) * (distance / self.distance);
        self.distance = distance;
    }

    /// Point under a pixel at the target's depth: the anchor of a zoom where nothing is under the pointer.
    pub fn at_target_depth(&self, pixel: DVec2, size: [f64; 2]) -> DVec3 {
        let ray = self.ray(pixel, size);
        let back = self.axes()[2];
        let t = (self.target - ray.origin).dot(back) / ray.direction.dot(back);
        ray.origin + ray.direction * t
    }

    /// Shows a whole box between two corners, from the same side as before.
    pub fn frame(&mut self, [min, max]: [DVec3; 2], size: [f64; 2]) {
        if !(min.is_finite() && max.is_finite()) {
            return;
        }
        let radius = (0.5 * (max - min).length()).max(1e-3);
        let half = 0.5 * self.fov;
        let narrow = (half.tan() * aspect(size).min(1.0)).atan();
        self.target = 0.5 * (min + max);
        self.distance = (radius / narrow.sin()).clamp(DISTANCES[0], DISTANCES[1]);
    }

    /// Looks from a standard side.
    pub fn look(&mut self, from: Standard) {
        (self.yaw, self.pitch) = match from {
            Standard::Front => (0.0, 0.0),
            Standard::Back => (PI, 0.0),
            Standard::Right => (FRAC_PI_2, 0.0),
            Standard::Left => (-FRAC_PI_2, 0.0),
            Standard::Top => (0.0, FRAC_PI_2),
            Standard::Bottom => (0.0, -FRAC_PI_2),
            // The three axes are equally long.
            Standard::Isometric => (0.25 * PI, (1.0 / 3f64.sqrt()).asin()),
        };
    }

    /// Whether all numbers of the camera are finite and within their bounds.
    pub fn is_valid(&self) -> bool {
        let all = [self.yaw, self.pitch, self.distance, self.fov];
        self.target.is_finite()
            && all.iter().all(|x| x.is_finite())
            && self.pitch.abs() <= FRAC_PI_2
            && (DISTANCES[0]..=DISTANCES[1]).contains(&self.distance)
            && (0.01..3.0).contains(&self.fov)
    }
}

fn aspect(size: [f64; 2]) -> f64 {
    size[0].max(1.0) / size[1].max(1.0)
}

#[cfg(test)]
mod tests;
