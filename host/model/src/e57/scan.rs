//! A scan: the fields of its points, those among them that are positions and normals, and their new numbers.
//!
//! A *row* is the part of a point that is read: the bits of those fields.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use glam::{DVec3, Mat3, Vec3};

use super::description::{CARTESIAN, Corner, Described, SPHERICAL};
use super::fields::{E57Field, NumberEncoding, range_over};
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
    /// Index in the model of the scan's first point.
    pub first: u64,
    /// The fields of a row.
    pub row: Vec<usize>,
    /// Fields of the numbers that turn with the surface besides normals, in the order of those numbers; none
    /// where the scan lacks one.
    pub turning: Vec<Option<usize>>,
    /// Types of the row's fields as they are stored, and (`written`) as they are written: with other ranges
    /// where these were chosen.
    kinds: Vec<NumberEncoding>,
    written: Vec<NumberEncoding>,
    roles: Roles,
    /// The field by whose numbers points are told to be in a part of the file; none where no field takes any
    /// bits.
    pub lead: Option<usize>,
    pub has_normals: bool,
    /// Whether the text declares limits of x, y and z, and of range, azimuth and elevation.
    wants: [bool; 2],
}

/// Places of coordinates, their states and normals in a row.
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
pub(super) struct CoordinateOverflow {
    pub field: usize,
    pub value: f64,
}

/// Field whose bits allow no range that is wide enough: the field, and the least and the largest number that
/// it would have.
#[derive(Debug, Clone, Copy)]
pub(super) struct TooWide {
    pub field: usize,
    pub ends: [f64; 2],
}

/// An angle by which points turn further than samples at most: near the scanner it could be any.
const MOST_TURN: f64 = 0.1;

/// Coordinate of a position, as the fields of positions have it.
#[derive(Debug, Clone, Copy)]
struct Coordinate {
    number: f64,
    /// Margin by which the number may be less or more nearby, and (`most`) its largest possible magnitude.
    margin: f64,
    most: f64,
    is_angle: bool,
    /// The coordinate is the same after a full turn.
    turns: bool,
}

impl Coordinate {
    /// The number plus whole turns, within a range if possible; or else next to another number.
    fn beside(&self, other: f64, (least, most): (f64, f64)) -> f64 {
        if !self.turns {
            return self.number;
        }
        let turned = [0.0, TAU, -TAU].map(|turn| self.number + turn);
        let within = turned.into_iter().find(|number| (least..=most).contains(number));
        within.unwrap_or_else(|| self.number + TAU * ((other - self.number) / TAU).round())
    }
}

/// Boxes of points in the scan's own frame: of x, y and z, and of range, azimuth and elevation.
pub(super) type ScanReach = [Bounds; 2];

impl Scan {
    /// Scan from its description; none if its points have no positions.
    pub fn new(described: Described, packets: Packets, first: u64) -> Option<Self> {
        let fields = &described.fields;
        let mut row = Vec::new();
        let called = |name: &str| fields.iter().position(|field| field.is_number() && field.name == name);
        let extension = |name: &str| {
            let is = |field: &E57Field| field.name.split_once(':').is_some_and(|(_, rest)| rest == name);
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
        let kinds: Vec<NumberEncoding> = row.iter().map(|field| fields[*field].kind).collect();
        let written = kinds.clone();
        Some(Self {
            described,
            packets,
            first,
            row,
            turning: Vec::new(),
            kinds,
            written,
            roles,
            lead,
            has_normals,
            wants,
        })
    }

    /// Fields that are written anew: those of a row, and those that turn.
    pub fn patched(&self) -> Vec<usize> {
        let others = self.turning.iter().flatten().filter(|field| !self.row.contains(field));
        self.row.iter().chain(others).copied().collect()
    }

    /// Range of the scan's points in the model.
    pub fn vertices(&self) -> Range<u64> {
        self.first..self.first + self.described.count
    }

    /// Whether the scan's points have spherical coordinates.
    pub fn has_spherical(&self) -> bool {
        self.roles.spherical.is_some()
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

    fn field(&self, of_row: usize) -> &E57Field {
        &self.described.fields[self.row[of_row]]
    }

    /// Steps from one number to the next of positions that are written, along three directions at right
    /// angles, the coarsest of cartesian and spherical ones; zero where positions are floats.
    pub fn step(&self) -> DVec3 {
        if let Some(three) = self.roles.cartesian {
            return DVec3::from(three.map(|i| self.field(i).step()));
        }
        let Some(three) = self.roles.spherical else { return DVec3::ZERO };
        let [range, azimuth, elevation] = three.map(|i| self.field(i).step());
        // The farthest point is at the largest range that the file declares.
        let corner = Corner { is_spherical: true, axis: 0, is_max: true };
        let told = self.described.slots.iter().filter(|slot| slot.corner == corner).map(|slot| slot.value);
        let field = self.field(three[0]);
        let widest = if field.step() > 0.0 { field.range().1 } else { f64::INFINITY };
        let far = told.fold(widest, f64::min);
        let far = if far.is_finite() { far } else { 0.0 };
        DVec3::new(range, far * azimuth, far * elevation)
    }

    #[inline]
    fn value(&self, row: &[u64], of_row: usize) -> f64 {
        self.kinds[of_row].value(row[of_row])
    }

    #[inline]
    fn three(&self, row: &[u64], three: [usize; 3]) -> [f64; 3] {
        three.map(|i| self.value(row, i))
    }

    /// Places of x, y and z in a row, if the row says that its position is valid.
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
        self.local_of(&self.kinds, row)
    }

    #[inline]
    fn local_of(&self, kinds: &[NumberEncoding], row: &[u64]) -> DVec3 {
        let values = |three: [usize; 3]| three.map(|i| kinds[i].value(row[i]));
        if let Some(three) = self.valid_cartesian(row) {
            return DVec3::from(values(three));
        }
        match self.valid_spherical(row) {
            Some(three) => cartesian(values(three)),
            None => DVec3::NAN,
        }
    }

    /// The position of a row's point in the frame of all scans.
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

    /// Turns a row into the row that is written: with its point at another place, if the point moves from one
    /// position to another, both in the frame of all scans. Returns whether any bits changed.
    pub fn move_point(&self, row: &mut [u64], moves: Option<[DVec3; 2]>) -> Result<bool, CoordinateOverflow> {
        let before = self.local(row);
        let (flat, polar) = (self.valid_cartesian(row), self.valid_spherical(row));
        let azimuth_before = polar.map_or(0.0, |[_, azimuth, _]| self.value(row, azimuth));
        // By how much, so that far away from the frame's origin no digits are lost.
        let turned = moves.map(|[from, to]| before + self.described.pose.turned_back(to - from));
        let moves_along = |axis: usize| turned.is_some_and(|after| after[axis] != before[axis]);
        let mut changed = false;
        if self.has_other_ranges() {
            let is_kept = |of_row: usize| {
                let axis = flat.and_then(|three| three.iter().position(|i| *i == of_row));
                axis.map_or(polar.is_none_or(|polar| !polar.contains(&of_row)) || turned.is_none(), |axis| {
                    !moves_along(axis)
                })
            };
            let valid = |of_row: &usize| flat.iter().chain(&polar).flatten().any(|i| i == of_row);
            for of_row in 0..row.len() {
                if self.written[of_row] != self.kinds[of_row] && is_kept(of_row) {
                    changed |= self.renumber(row, of_row, valid(&of_row))?;
                }
            }
        }
        let (Some(after), Some([_, to])) = (turned, moves) else { return Ok(changed) };
        if !after.is_finite() {
            let axis = (0..3).find(|axis| !to[*axis].is_finite()).unwrap_or(0);
            let field =
                self.roles.cartesian.or(self.roles.spherical).map_or(0, |three| self.row[three[axis]]);
            return Err(CoordinateOverflow { field, value: to[axis] });
        }
        for (axis, of_row) in flat.into_iter().flatten().enumerate() {
            if moves_along(axis) {
                changed |= self.put(row, of_row, &[after[axis]])?;
            }
        }
        if let Some([range, azimuth, elevation]) = polar {
            let [r, a, e] = spherical(after);
            changed |= self.put(row, range, &[r])?;
            changed |= self.put(row, elevation, &[e, self.held(elevation, e)])?;
            // Straight above the scanner any will do, and it stays; some programs count from 0 to a full
            // turn.
            if after.x != 0.0 || after.y != 0.0 {
                let a = if a < 0.0 && azimuth_before > PI { a + TAU } else { a };
                let [more, less] = [a + TAU, a - TAU];
                let held = [a, more, less].map(|a| self.held(azimuth, a));
                changed |= self.put(row, azimuth, &[a, more, less, held[0], held[1], held[2]])?;
            }
        }
        Ok(changed)
    }

    /// Whether integers are written with other ranges than they are stored with.
    pub fn has_other_ranges(&self) -> bool {
        self.written != self.kinds
    }

    /// Writes the same number in another range; one that says nothing, and is beyond, becomes the end of the
    /// range.
    fn renumber(&self, row: &mut [u64], of_row: usize, is_valid: bool) -> Result<bool, CoordinateOverflow> {
        let (NumberEncoding::Integer { min: old, .. }, NumberEncoding::Integer { min, max, .. }) =
            (self.kinds[of_row], self.written[of_row])
        else {
            return Ok(false);
        };
        let number = old.wrapping_add(row[of_row].cast_signed());
        if is_valid && !(min..=max).contains(&number) {
            return Err(CoordinateOverflow { field: self.row[of_row], value: self.value(row, of_row) });
        }
        let bits = number.clamp(min, max).wrapping_sub(min).cast_unsigned();
        let changed = row[of_row] != bits;
        row[of_row] = bits;
        Ok(changed)
    }

    /// Chooses ranges for the integers of positions where these have no room for points that go from the
    /// first place of a pair to the second, in the frame of all scans, and further by a margin; of those
    /// pairs that begin where the scan may have points.
    ///
    /// # Errors
    /// A field has too few bits for any range.
    pub fn make_room(&mut self, moves: &[[DVec3; 2]], margin: f64) -> Result<(), TooWide> {
        let fields: Vec<usize> =
            self.roles.cartesian.into_iter().chain(self.roles.spherical).flatten().collect();
        let ends: Vec<(f64, f64)> = fields.iter().map(|i| self.kinds[*i].range()).collect();
        let mut reach = vec![(f64::INFINITY, f64::NEG_INFINITY); fields.len()];
        for [from, to] in moves {
            let (starts, goals) = (self.coordinates(*from, margin), self.coordinates(*to, margin));
            let of = || starts.iter().zip(&goals).zip(&ends);
            let is_within = |((start, _), ends): ((&Coordinate, _), &(f64, f64))| {
                let number = start.beside(start.number, *ends);
                (ends.0 - start.margin..=ends.1 + start.margin).contains(&number)
            };
            if !of().all(is_within) {
                continue;
            }
            for (((start, goal), ends), reach) in of().zip(&mut reach) {
                // Next to the others.
                let others = f64::midpoint(reach.0, reach.1);
                let number = goal.beside(if others.is_finite() { others } else { start.number }, *ends);
                let (mut least, mut most) =
                    ((number - goal.margin).max(-goal.most), (number + goal.margin).min(goal.most));
                if goal.is_angle && from == to {
                    // Points that stay have room.
                    (least, most) = (least.clamp(ends.0, ends.1), most.clamp(ends.0, ends.1));
                }
                *reach = (reach.0.min(least), reach.1.max(most));
            }
        }
        for ((of_row, (least, most)), ends) in fields.into_iter().zip(reach).zip(ends) {
            let NumberEncoding::Integer { min, max, scale, offset } = self.kinds[of_row] else { continue };
            // All around there is room for any azimuth.
            let is_azimuth = self.roles.spherical.is_some_and(|[_, azimuth, _]| azimuth == of_row);
            let is_all_around = is_azimuth && ends.1 - ends.0 + 2.0 * scale.abs() > TAU;
            if least > most || (least >= ends.0 && most <= ends.1) || is_all_around {
                continue;
            }
            let steps = [least, most].map(|number| (number - offset) / scale);
            let (least_step, most_step) = (steps[0].min(steps[1]), steps[0].max(steps[1]));
            let bits = self.field(of_row).bits();
            let Some([min, max]) = range_over([min, max], bits, least_step, most_step) else {
                return Err(TooWide { field: self.row[of_row], ends: [least, most] });
            };
            self.written[of_row] = NumberEncoding::Integer { min, max, scale, offset };
        }
        Ok(())
    }

    /// Coordinates of a place in the frame of all scans: x, y and z, if points have them, and then range,
    /// azimuth and elevation; each with the margin that follows from one around the place.
    fn coordinates(&self, p: DVec3, margin: f64) -> Vec<Coordinate> {
        let local = self.described.pose.turned_back(p - self.described.pose.translation);
        let length =
            |number| Coordinate { number, margin, most: f64::INFINITY, is_angle: false, turns: false };
        let mut all = Vec::new();
        if self.roles.cartesian.is_some() {
            all.extend(local.to_array().map(length));
        }
        if self.roles.spherical.is_some() {
            let [range, azimuth, elevation] = spherical(local);
            let angle = |number, radius: f64, most, turns| {
                let margin = (margin / radius.max(f64::MIN_POSITIVE)).min(MOST_TURN);
                Coordinate { number, margin, most, is_angle: true, turns }
            };
            all.push(length(range));
            all.push(angle(azimuth, local.truncate().length(), f64::INFINITY, true));
            all.push(angle(elevation, range, PI / 2.0, false));
        }
        all
    }

    /// Whether any point may be at a position in the frame of all scans: the fields hold it, or it is hardly
    /// beyond their range, since a field may reach just as far as its points do, and a position be rounded.
    pub fn has_room_for(&self, p: DVec3) -> bool {
        const HARDLY: f64 = 1e-3;
        let local = self.described.pose.turned_back(p - self.described.pose.translation);
        let fits = |of_row: usize, number: f64| {
            let (least, most) = self.written[of_row].range();
            let margin = HARDLY * (most - least).abs().min(f64::MAX);
            (least - margin..=most + margin).contains(&number)
        };
        let Roles { cartesian, spherical: polar, .. } = &self.roles;
        let flat = cartesian.is_none_or(|three| (0..3).all(|axis| fits(three[axis], local[axis])));
        flat && polar.is_none_or(|[range, ..]| fits(range, spherical(local)[0]))
    }

    /// Turns a normal to another one, in the frame of all scans; returns whether any bits changed. Numbers
    /// that a field cannot hold stay as they were.
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

    /// Turns the numbers of an attribute by `turn`, with a gradient in the frame of all scans: `bits` are
    /// those of [`turning`](Self::turning) that the scan has. Returns whether any changed; numbers that a
    /// field cannot hold stay as they were.
    pub fn turn(&self, bits: &mut [u64], gradient: &Mat3, turn: impl FnOnce(&Mat3, &mut [f64])) -> bool {
        let fields = &self.described.fields;
        let mut there = bits.iter();
        let bits_of = |field: &Option<usize>| {
            field.and_then(|field| Some(fields[field].value(*there.next()?))).unwrap_or(f64::NAN)
        };
        let old: Vec<f64> = self.turning.iter().map(bits_of).collect();
        let mut new = old.clone();
        turn(&self.described.pose.gradient_in_scan(gradient), &mut new);
        let mut changed = false;
        let own = self.turning.iter().zip(old.iter().zip(&new));
        let own = own.filter_map(|(field, numbers)| field.map(|field| (&fields[field], numbers)));
        for (bits, (field, (old, new))) in bits.iter_mut().zip(own) {
            if old.to_bits() != new.to_bits()
                && let Some(nearest) = field.kind.nearest(*new)
            {
                changed |= *bits != nearest;
                *bits = nearest;
            }
        }
        changed
    }

    /// Angle held to the range of its field if it is beyond that range by less than a step.
    fn held(&self, of_row: usize, angle: f64) -> f64 {
        let (least, most) = self.written[of_row].range();
        let near = angle.clamp(least, most);
        if (near - angle).abs() <= self.field(of_row).step() { near } else { angle }
    }

    /// Puts the first of some numbers that the field can hold; whether its bits change.
    #[inline]
    fn put(&self, row: &mut [u64], of_row: usize, numbers: &[f64]) -> Result<bool, CoordinateOverflow> {
        let kind = self.written[of_row];
        let bits = numbers.iter().find_map(|number| kind.nearest(*number));
        let bits = bits.ok_or(CoordinateOverflow { field: self.row[of_row], value: numbers[0] })?;
        let changed = row[of_row] != bits;
        row[of_row] = bits;
        Ok(changed)
    }

    /// Coordinates of a point that count for the declared limits, both kinds; none for a point without a
    /// position, and none of a kind without limits.
    #[inline]
    pub fn reach(&self, row: &[u64]) -> [Option<DVec3>; 2] {
        self.reach_of(&self.kinds, row)
    }

    /// Coordinates of the point of a row that is written, as [`reach`](Self::reach) has them of one that is
    /// stored.
    #[inline]
    pub fn new_reach(&self, row: &[u64]) -> [Option<DVec3>; 2] {
        self.reach_of(&self.written, row)
    }

    #[inline]
    fn reach_of(&self, kinds: &[NumberEncoding], row: &[u64]) -> [Option<DVec3>; 2] {
        let local = Some(self.local_of(kinds, row)).filter(|local| local.is_finite());
        let polar = local.filter(|_| self.wants[1]).map(|local| {
            let told = self.valid_spherical(row).map(|three| three.map(|i| kinds[i].value(row[i])));
            DVec3::from(told.unwrap_or_else(|| spherical(local)))
        });
        [local.filter(|_| self.wants[0]), polar]
    }

    pub fn wants_reach(&self) -> bool {
        self.wants != [false; 2]
    }

    /// Range that a field of the scan can hold, in the scan's own frame.
    pub fn range(&self, field: usize) -> (f64, f64) {
        let of_row = self.row.iter().position(|of_row| *of_row == field);
        of_row.map_or(self.described.fields[field].kind, |of_row| self.written[of_row]).range()
    }

    /// Ranges of integers that are written, where they differ from the stored ones: the field, and the least
    /// and the largest number.
    pub fn other_ranges(&self) -> impl Iterator<Item = (usize, [i64; 2])> {
        let all = self.row.iter().zip(&self.kinds).zip(&self.written);
        all.filter(|((_, old), new)| old != new).filter_map(|((field, _), new)| match new {
            NumberEncoding::Integer { min, max, .. } => Some((*field, [*min, *max])),
            _ => None,
        })
    }
}

/// Appends fields to the row, if all are there; returns their places in the row.
fn all<const N: usize>(fields: [Option<usize>; N], row: &mut Vec<usize>) -> Option<[usize; N]> {
    if fields.iter().any(Option::is_none) {
        return None;
    }
    let first = row.len();
    row.extend(fields.into_iter().flatten());
    Some(std::array::from_fn(|i| first + i))
}

/// The number of a reach that a place in the text is about.
pub(super) fn corner_of(reach: &ScanReach, corner: Corner) -> f64 {
    let bounds = &reach[usize::from(corner.is_spherical)];
    if corner.is_max { bounds.max[corner.axis] } else { bounds.min[corner.axis] }
}
