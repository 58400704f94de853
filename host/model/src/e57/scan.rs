//! A scan: its points' fields, which of them are positions and normals, and what becomes of these.
//!
//! A *row* is what is read of a point: the bits of those fields.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use glam::{DVec3, Vec3};

use super::description::{CARTESIAN, Corner, Described, SPHERICAL};
use super::fields::{Field, Kind};
use super::packets::Packets;
use super::pose::{cartesian, spherical};
use crate::bounds::Bounds;

/// The names of normals, in the extension that has them.
const NORMAL: [&str; 3] = ["normalX", "normalY", "normalZ"];

/// Bytes of a number in a row.
pub(super) const NUMBER: usize = 8;

/// A scan of a file.
#[derive(Debug)]
pub(super) struct Scan {
    pub described: Described,
    pub packets: Packets,
    /// The model's number of its first point.
    pub first: u64,
    /// The fields of a row.
    pub row: Vec<usize>,
    /// How they are stored.
    kinds: Vec<Kind>,
    roles: Roles,
    /// The field by whose numbers points are told to be in a part of the file; none where no field takes any
    /// bits.
    pub lead: Option<usize>,
    pub has_normals: bool,
    /// Whether the text says how far x, y and z reach, and range, azimuth and elevation.
    wants: [bool; 2],
}

/// Where in a row things are.
#[derive(Debug, Default)]
struct Roles {
    cartesian: Option<[usize; 3]>,
    cartesian_state: Option<usize>,
    spherical: Option<[usize; 3]>,
    spherical_state: Option<usize>,
    normal: Option<[usize; 3]>,
}

/// A coordinate that a field cannot hold: the field, and the number.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beyond {
    pub field: usize,
    pub value: f64,
}

/// How far points reach: in x, y and z, and in range, azimuth and elevation, in the scan's own frame.
pub(super) type Reach = [Bounds; 2];

impl Scan {
    /// None if its points have no positions.
    pub fn new(described: Described, packets: Packets, first: u64) -> Option<Self> {
        let fields = &described.fields;
        let mut row = Vec::new();
        let called = |name: &str| fields.iter().position(|field| field.is_number() && field.name == name);
        let extension = |name: &str| {
            let is = |field: &Field| field.name.split_once(':').is_some_and(|(_, rest)| rest == name);
            fields.iter().position(|field| field.is_number() && is(field))
        };
        let roles = Roles {
            cartesian: all(CARTESIAN.map(called), &mut row),
            cartesian_state: all([called("cartesianInvalidState")], &mut row).map(|[state]| state),
            spherical: all(SPHERICAL.map(called), &mut row),
            spherical_state: all([called("sphericalInvalidState")], &mut row).map(|[state]| state),
            normal: all(NORMAL.map(extension), &mut row),
        };
        if roles.cartesian.is_none() && roles.spherical.is_none() {
            return None;
        }
        let takes_bits = |field: &usize| fields[*field].bits() > 0;
        let lead = row.iter().copied().find(takes_bits).or_else(|| (0..fields.len()).find(takes_bits));
        let has_normals = roles.normal.is_some();
        let wants = [false, true]
            .map(|is_spherical| described.slots.iter().any(|slot| slot.corner.is_spherical == is_spherical));
        let kinds = row.iter().map(|field| fields[*field].kind).collect();
        Some(Self { described, packets, first, row, kinds, roles, lead, has_normals, wants })
    }

    /// The model's numbers of its points.
    pub fn vertices(&self) -> Range<u64> {
        self.first..self.first + self.described.count
    }

    /// Fields that are neither positions nor normals, but numbers.
    pub fn attributes(&self, with_normals: bool) -> impl Iterator<Item = usize> {
        let of =
            |three: &Option<[usize; 3]>| three.iter().flatten().map(|i| self.row[*i]).collect::<Vec<_>>();
        let Roles { cartesian, spherical, normal, .. } = &self.roles;
        let mut others = [of(cartesian), of(spherical)].concat();
        if !with_normals {
            others.extend(of(normal));
        }
        (0..self.described.fields.len())
            .filter(move |field| self.described.fields[*field].is_number() && !others.contains(field))
    }

    fn field(&self, of_row: usize) -> &Field {
        &self.described.fields[self.row[of_row]]
    }

    #[inline]
    fn value(&self, row: &[u64], of_row: usize) -> f64 {
        self.kinds[of_row].value(row[of_row])
    }

    #[inline]
    fn three(&self, row: &[u64], three: [usize; 3]) -> [f64; 3] {
        three.map(|i| self.value(row, i))
    }

    /// Where x, y and z are in a row, if they are said to be a position.
    #[inline]
    fn valid_cartesian(&self, row: &[u64]) -> Option<[usize; 3]> {
        let is_valid = |state: &usize| self.value(row, *state) == 0.0;
        self.roles.cartesian.filter(|_| self.roles.cartesian_state.as_ref().is_none_or(is_valid))
    }

    #[inline]
    fn valid_spherical(&self, row: &[u64]) -> Option<[usize; 3]> {
        let is_valid = |state: &usize| self.value(row, *state) == 0.0;
        self.roles.spherical.filter(|_| self.roles.spherical_state.as_ref().is_none_or(is_valid))
    }

    /// A position in the scan's own frame; not finite where the file says that it is none.
    #[inline]
    pub fn local(&self, row: &[u64]) -> DVec3 {
        if let Some(three) = self.valid_cartesian(row) {
            return DVec3::from(self.three(row, three));
        }
        match self.valid_spherical(row) {
            Some(three) => cartesian(self.three(row, three)),
            None => DVec3::NAN,
        }
    }

    /// The same in the frame of all scans.
    #[inline]
    pub fn position(&self, row: &[u64]) -> DVec3 {
        self.described.pose.position(self.local(row))
    }

    /// A normal in the frame of all scans.
    #[inline]
    pub fn normal(&self, row: &[u64]) -> Vec3 {
        let Some(three) = self.roles.normal else { return Vec3::ZERO };
        self.described.pose.turned(DVec3::from(self.three(row, three))).as_vec3()
    }

    /// Moves a point from one position to another, both in the frame of all scans; whether any bits changed.
    pub fn move_point(&self, row: &mut [u64], from: DVec3, to: DVec3) -> Result<bool, Beyond> {
        let before = self.local(row);
        // By how much, so that far away from the frame's origin no digits are lost.
        let after = before + self.described.pose.turned_back(to - from);
        if !after.is_finite() {
            let axis = (0..3).find(|axis| !to[*axis].is_finite()).unwrap_or(0);
            let field =
                self.roles.cartesian.or(self.roles.spherical).map_or(0, |three| self.row[three[axis]]);
            return Err(Beyond { field, value: to[axis] });
        }
        let (flat, polar) = (self.valid_cartesian(row), self.valid_spherical(row));
        let mut changed = false;
        for (axis, of_row) in flat.into_iter().flatten().enumerate() {
            if after[axis] != before[axis] {
                changed |= self.put(row, of_row, &[after[axis]])?;
            }
        }
        if let Some([range, azimuth, elevation]) = polar {
            let [r, a, e] = spherical(after);
            changed |= self.put(row, range, &[r])?;
            changed |= self.put(row, elevation, &[e])?;
            // Straight above the scanner any will do, and it stays; some programs count from 0 to a full
            // turn.
            if after.x != 0.0 || after.y != 0.0 {
                let a = if a < 0.0 && self.value(row, azimuth) > PI { a + TAU } else { a };
                changed |= self.put(row, azimuth, &[a, a + TAU, a - TAU])?;
            }
        }
        Ok(changed)
    }

    /// Whether any point may be at a position in the frame of all scans, or hardly beyond what the fields hold: a
    /// field may reach just as far as its points do, and a position be rounded.
    pub fn has_room_for(&self, p: DVec3) -> bool {
        const HARDLY: f64 = 1e-3;
        let local = self.described.pose.turned_back(p - self.described.pose.translation);
        let fits = |of_row: usize, number: f64| {
            let (least, most) = self.field(of_row).range();
            let margin = HARDLY * (most - least).abs().min(f64::MAX);
            (least - margin..=most + margin).contains(&number)
        };
        let Roles { cartesian, spherical: polar, .. } = &self.roles;
        let flat = cartesian.is_none_or(|three| (0..3).all(|axis| fits(three[axis], local[axis])));
        flat && polar.is_none_or(|[range, ..]| fits(range, spherical(local)[0]))
    }

    /// Turns a normal to another one, in the frame of all scans; whether any bits changed. What a field
    /// cannot hold stays.
    pub fn turn_normal(&self, row: &mut [u64], from: Vec3, to: Vec3) -> bool {
        let Some(three) = self.roles.normal else { return false };
        if from.to_array().map(f32::to_bits) == to.to_array().map(f32::to_bits) || !to.is_finite() {
            return false;
        }
        let turned = self.described.pose.turned_back(to.as_dvec3());
        let before = self.described.pose.turned_back(from.as_dvec3());
        let mut changed = false;
        for (axis, of_row) in three.into_iter().enumerate() {
            if turned[axis] != before[axis] {
                let (least, most) = self.field(of_row).range();
                changed |= self.put(row, of_row, &[turned[axis].clamp(least, most)]).unwrap_or(false);
            }
        }
        changed
    }

    /// Puts the first of some numbers that the field can hold; whether its bits change.
    #[inline]
    fn put(&self, row: &mut [u64], of_row: usize, numbers: &[f64]) -> Result<bool, Beyond> {
        let field = self.field(of_row);
        let bits = numbers.iter().find_map(|number| field.nearest(*number));
        let bits = bits.ok_or(Beyond { field: self.row[of_row], value: numbers[0] })?;
        let changed = row[of_row] != bits;
        row[of_row] = bits;
        Ok(changed)
    }

    /// How far a point reaches, as far as the text says it of all: nowhere, if it has no position.
    #[inline]
    pub fn reach(&self, row: &[u64]) -> [Option<DVec3>; 2] {
        let local = Some(self.local(row)).filter(|local| local.is_finite());
        let polar = local.filter(|_| self.wants[1]).map(|local| {
            let told = self.valid_spherical(row).map(|three| self.three(row, three));
            DVec3::from(told.unwrap_or_else(|| spherical(local)))
        });
        [local.filter(|_| self.wants[0]), polar]
    }

    pub fn wants_reach(&self) -> bool {
        self.wants != [false; 2]
    }

    /// The range of an axis in the scan's own frame that its fields can hold.
    pub fn range(&self, field: usize) -> (f64, f64) {
        self.described.fields[field].range()
    }
}

/// Puts fields into the row, if all are there; where they are in it.
fn all<const N: usize>(fields: [Option<usize>; N], row: &mut Vec<usize>) -> Option<[usize; N]> {
    if fields.iter().any(Option::is_none) {
        return None;
    }
    let first = row.len();
    row.extend(fields.into_iter().flatten());
    Some(std::array::from_fn(|i| first + i))
}

/// The number of a reach that a place in the text is about.
pub(super) fn corner_of(reach: &Reach, corner: Corner) -> f64 {
    let bounds = &reach[usize::from(corner.is_spherical)];
    if corner.is_max { bounds.max[corner.axis] } else { bounds.min[corner.axis] }
}
